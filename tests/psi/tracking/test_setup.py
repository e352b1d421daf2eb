from __future__ import annotations

from mqslam.config import Config
from mqslam.psi.place import beam_of
from mqslam.psi.tracking.matching import Matcher


def test_the_speeds_that_are_tried_are_those_of_the_vehicle_in_reverse() -> None:
    estimator = Config().estimator
    tracker, beam = Config().tracker.model_copy(update={"speed_max": 40.0}), beam_of(estimator, 0.0)
    assert Matcher(tracker, estimator, beam, 0.25).speeds == (-5.0, 40.0)
    assert Matcher(tracker, estimator, beam, 0.25, is_reversed=True).speeds == (-40.0, 5.0)
