"""A simulated city: kilometres of streets with houses, courtyards, a park, a river and traffic, and a drive through it."""

from mqslam.simulator.city.drive import make_city_drive
from mqslam.simulator.city.scene import give_way, make_city_scene

__all__ = ["give_way", "make_city_drive", "make_city_scene"]
