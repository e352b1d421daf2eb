"""Simulates a radar drive: a geometric scene, a true motion, a spinning radar, wheels that slip, a gyroscope and GNSS.

`simulate_recording` makes a recording in memory, and `simulate` also writes the recording to disk in the Oxford layout. Both
take a function that makes a `World`, which determines the power that the radar receives and the time of each azimuth.
"""

from mqslam.core.velocity import CHIRP_BETA
from mqslam.simulator.city import give_way, make_city_drive, make_city_scene
from mqslam.simulator.drive import ConstantDrive, Drive, SampledDrive, clear_way, make_loop_drive, make_tunnel_drive
from mqslam.simulator.instruments import (
    GRADES,
    GyroscopeModel,
    OdometryModel,
    ReceiverModel,
    WheelOdometry,
    simulate_fixes,
    simulate_gyroscope,
    simulate_wheel_odometry,
)
from mqslam.simulator.recording import (
    START_US,
    ClearWorld,
    MakeWorld,
    SimulatedRecording,
    World,
    simulate_recording,
)
from mqslam.simulator.scene import Scene, make_corridor_scene, make_street_scene, make_tunnel_scene, make_yard_scene
from mqslam.simulator.sensor import SensorModel, render_polar_scan
from mqslam.simulator.write import SCENES, simulate

__all__ = [
    "CHIRP_BETA",
    "GRADES",
    "SCENES",
    "START_US",
    "ClearWorld",
    "ConstantDrive",
    "Drive",
    "GyroscopeModel",
    "MakeWorld",
    "OdometryModel",
    "ReceiverModel",
    "SampledDrive",
    "Scene",
    "SensorModel",
    "SimulatedRecording",
    "WheelOdometry",
    "World",
    "clear_way",
    "give_way",
    "make_city_drive",
    "make_city_scene",
    "make_corridor_scene",
    "make_loop_drive",
    "make_street_scene",
    "make_tunnel_drive",
    "make_tunnel_scene",
    "make_yard_scene",
    "render_polar_scan",
    "simulate",
    "simulate_fixes",
    "simulate_gyroscope",
    "simulate_recording",
    "simulate_wheel_odometry",
]
