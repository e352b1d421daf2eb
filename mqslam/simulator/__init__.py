"""A simulated radar drive: a geometric scene, a true motion, a spinning radar and wheels that slip.

`simulated_stream` renders a drive in memory, `simulate` writes the same stream as a recording in the Oxford layout.
"""

from mqslam.simulator.drive import ConstantDrive, Drive, SampledDrive, loop_drive, with_way_made
from mqslam.simulator.in_memory import SimulatedStream, simulated_stream
from mqslam.simulator.scene import Scene, corridor_scene, street_scene, yard_scene
from mqslam.simulator.sensor import SensorModel, render_revolution
from mqslam.simulator.wheels import OdometryModel, WheelOdometry, wheel_odometry
from mqslam.simulator.write import SCENES, simulate

__all__ = [
    "SCENES",
    "ConstantDrive",
    "Drive",
    "OdometryModel",
    "SampledDrive",
    "Scene",
    "SensorModel",
    "SimulatedStream",
    "WheelOdometry",
    "corridor_scene",
    "loop_drive",
    "render_revolution",
    "simulate",
    "simulated_stream",
    "street_scene",
    "wheel_odometry",
    "with_way_made",
    "yard_scene",
]
