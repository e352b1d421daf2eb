"""The published score, and the paper's table and figures reproduced with it.

Source: "Motion Estimation from Map Quality with Millimeter Wave Radar".
"""
