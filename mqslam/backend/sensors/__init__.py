"""Calibrates odometry, gyroscopes, GNSS and velocities from chirps by the front end's motions, and adds them to the graph.

A sensor that contradicts the front end is refused. The pose of the radar on the vehicle is estimated here, too.
"""
