"""Computes the score as the paper published it, and reproduces the paper's table and figures.

Source: "Motion Estimation from Map Quality with Millimeter Wave Radar".
"""
