"""The magnitudes of the hard world, each with its unit and reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Realism:
    """How strong every effect of the hard world is; the values make its recordings as hard as real ones of a CTS350-X.

    Levels are powers in decibels over a reading of 0, of a scatterer 20 m away; the receiver's noise lies at about 3 dB.

    Args:
        wall_db: typical level of a scatterer of a house wall: a few of them stand out of many.
        pole_db: the same of a pole, a trunk or a sign.
        plant_db: the same of leaves and twigs.
        vehicle_db: the same of a vehicle's body.
        ground_db: the same of bare ground: kerbs, covers, gravel.
        spread_db: standard deviation of the levels of scatterers of one material.
        range_law: power falls with range to this power; 4 in free space, less over ground and for what fills the beam.
        spacing_m: mean distance between the scatterers of a wall or a vehicle: windows, ledges, pipes.
        wall_depth_m: standard deviation of a wall's scatterers about its plane.
        plant_density: scatterers per square metre of a plant's crown.

        wander_m: standard deviation of a scatter centre's place as the aspect changes: what shines is another part of it.
        aspect_deg: aspect over which places and strengths change.
        block_m: size of the blocks whose scatterers move and fade together.
        fading: share of a scatterer's power that changes with the aspect.
        glint_deg: half width of the glint of a flat face around its normal.
        wall_glint_db: level of a wall's glint over that of its rough part.
        vehicle_glint_db: the same of a vehicle, whose faces are curved.
        fluctuation: share of power that is drawn anew each turn, since the radar never comes by at the same millimetre.
        plant_fluctuation: the same for plants, which move in the wind.

        radar_height_m: of the antenna, on the roof of a car.
        lift_deg: half-power elevation of the beam above its middle; below, the pattern falls slowly, as cosecant squared.
        tilt_deg: standard deviation of pitch and roll at speed, from the road's unevenness and the springs.
        dive_deg: pitch per m/s^2 of braking.

        wall_depth: optical depth of a wall over that of the scene, whose beam passes partly above the walls.
        vehicle_opacity: share of the beam that one side of a vehicle takes from what is no higher than the vehicle.

        pacing: vehicles that keep pace with the own one at a time.
        oncoming_m: mean distance between oncoming vehicles.
        oncoming_mps: their speed.

        range_width_m: half-power width of a point along range: the Hann window over the sweep's bandwidth.
        foot: share of the two-way amplitude in the wide foot of the beam.
        foot_widths: width of the foot in widths of the main lobe.
        noise: mean power of the receiver's noise.
        noise_varies: relative half range by which the noise differs between azimuths.
        skirt_db: phase noise beside a strong target, below it.
        skirt_m: range over which the skirt falls by a factor of e.
        streak_db: phase noise over a whole azimuth, below its strongest target: bright azimuths.
        streak_varies: standard deviation of the natural logarithm of a streak.
        haze_db: diffuse multipath behind a target, below it.
        haze_m: range over which the haze falls by a factor of e.
        leakage: power that leaks from transmitter to receiver and shows in the first metres.

        bounce_db: a double bounce between two scatterers, below the geometric mean of their powers.
        echo_back_db: a bounce from a target to the own vehicle and back again, below the target.
        strays: short-lived echoes per turn: birds, rain, other radars, paths by way of what moves.
        stray_db: their level at any range.

        spin: relative standard deviation of the rate of turning, which drifts over some seconds.
    """

    wall_db: float = 49.0
    pole_db: float = 45.0
    plant_db: float = 39.0
    vehicle_db: float = 44.0
    ground_db: float = 4.0
    spread_db: float = 7.5
    range_law: float = 3.0
    spacing_m: float = 0.15
    wall_depth_m: float = 0.12
    plant_density: float = 4.0

    wander_m: float = 0.15
    aspect_deg: float = 3.0
    block_m: float = 0.75
    fading: float = 0.95
    glint_deg: float = 6.0
    wall_glint_db: float = 15.0
    vehicle_glint_db: float = 11.0
    fluctuation: float = 0.45
    plant_fluctuation: float = 0.9

    radar_height_m: float = 1.9
    lift_deg: float = 1.1
    tilt_deg: float = 0.5
    dive_deg: float = 0.3

    wall_depth: float = 1.5
    vehicle_opacity: float = 0.8

    pacing: float = 5.0
    oncoming_m: float = 40.0
    oncoming_mps: float = 9.0

    range_width_m: float = 0.38
    foot: float = 0.14
    foot_widths: float = 2.6
    noise: float = 2.1
    noise_varies: float = 0.25
    skirt_db: float = 30.0
    skirt_m: float = 0.9
    streak_db: float = 56.0
    streak_varies: float = 0.7
    haze_db: float = 43.0
    haze_m: float = 9.0
    leakage: float = 120.0

    bounce_db: float = 20.0
    echo_back_db: float = 28.0
    strays: float = 420.0
    stray_db: float = 22.0

    spin: float = 0.007


USUAL = Realism()
"""Those of the hard recordings that tests and benchmarks measure."""
