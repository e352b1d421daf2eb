"""The magnitudes of the hard world, each with its unit and reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Realism:
    """How strong every effect of the hard world is; the values make its recordings as hard as real ones of a CTS350-X.

    Levels are powers in decibels over a reading of 0, of a scatterer 20 m away; the receiver's noise lies at about 3 dB.
    """

    wall_db: float = 49.0  # typical level of a scatterer of a house wall: a few of them stand out of many
    pole_db: float = 45.0  # the same of a pole, a trunk or a sign
    plant_db: float = 39.0  # the same of leaves and twigs
    vehicle_db: float = 44.0  # the same of a vehicle's body
    ground_db: float = 4.0  # the same of bare ground: kerbs, covers, gravel
    spread_db: float = 7.5  # standard deviation of the levels of scatterers of one material
    # power falls with range to this power; 4 in free space, less over ground and for what fills the beam
    range_law: float = 3.0
    spacing_m: float = 0.15  # mean distance between the scatterers of a wall or a vehicle: windows, ledges, pipes
    wall_depth_m: float = 0.12  # standard deviation of a wall's scatterers about its plane
    plant_density: float = 4.0  # scatterers per square metre of a plant's crown

    # standard deviation of a scatter centre's place as the aspect changes: what shines is another part of it
    wander_m: float = 0.15
    aspect_deg: float = 3.0  # aspect over which places and strengths change
    block_m: float = 0.75  # size of the blocks whose scatterers move and fade together
    fading: float = 0.95  # share of a scatterer's power that changes with the aspect
    glint_deg: float = 6.0  # half width of the glint of a flat face around its normal
    wall_glint_db: float = 15.0  # level of a wall's glint over that of its rough part
    vehicle_glint_db: float = 11.0  # the same of a vehicle, whose faces are curved
    # share of power that is drawn anew each turn, since the radar never comes by at the same millimetre
    fluctuation: float = 0.45
    plant_fluctuation: float = 0.9  # the same for plants, which move in the wind

    radar_height_m: float = 1.9  # of the antenna, on the roof of a car
    # half-power elevation of the beam above its middle; below, the pattern falls slowly, as cosecant squared
    lift_deg: float = 1.1
    tilt_deg: float = 0.5  # standard deviation of pitch and roll at speed, from the road's unevenness and the springs
    dive_deg: float = 0.3  # pitch per m/s^2 of braking

    wall_depth: float = 1.5  # optical depth of a wall over that of the scene, whose beam passes partly above the walls
    # share of the beam that one side of a vehicle takes from what is no higher than the vehicle
    vehicle_opacity: float = 0.8

    pacing: float = 5.0  # vehicles that keep pace with the own one at a time
    oncoming_m: float = 40.0  # mean distance between oncoming vehicles
    oncoming_mps: float = 9.0  # their speed

    range_width_m: float = 0.38  # half-power width of a point along range: the Hann window over the sweep's bandwidth
    foot: float = 0.14  # share of the two-way amplitude in the wide foot of the beam
    foot_widths: float = 2.6  # width of the foot in widths of the main lobe
    noise: float = 2.1  # mean power of the receiver's noise
    noise_varies: float = 0.25  # relative half range by which the noise differs between azimuths
    skirt_db: float = 30.0  # phase noise beside a strong target, below it
    skirt_m: float = 0.9  # range over which the skirt falls by a factor of e
    streak_db: float = 56.0  # phase noise over a whole azimuth, below its strongest target: bright azimuths
    streak_varies: float = 0.7  # standard deviation of the natural logarithm of a streak
    haze_db: float = 43.0  # diffuse multipath behind a target, below it
    haze_m: float = 9.0  # range over which the haze falls by a factor of e
    leakage: float = 120.0  # power that leaks from transmitter to receiver and shows in the first metres

    bounce_db: float = 20.0  # a double bounce between two scatterers, below the geometric mean of their powers
    echo_back_db: float = 28.0  # a bounce from a target to the own vehicle and back again, below the target
    strays: float = 420.0  # short-lived echoes per turn: birds, rain, other radars, paths by way of what moves
    stray_db: float = 22.0  # their level at any range

    spin: float = 0.007  # relative standard deviation of the rate of turning, which drifts over some seconds


USUAL = Realism()
"""Those of the hard recordings that tests and benchmarks measure."""
