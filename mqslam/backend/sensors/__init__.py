"""Calibrates odometry, gyroscope, GNSS and the chirps' velocities by the front end's motions, and adds them to the graph.

A sensor that contradicts the front end is refused. The pose of the radar on the vehicle is estimated here, too.
"""
