"""The paper's table and figures, made again: "Motion Estimation from Map Quality with Millimeter Wave Radar"."""
