"""What the drawings of maps and paths show."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from mqslam.report.canvas import Drawing, draw_routes, draw_world, mix_shades, over


@pytest.mark.parametrize("count", [2, 7])
def test_routes_along_one_road_are_all_seen(count: int) -> None:
    road, colours = over(np.arange(50.0), np.sin(np.arange(50.0))), mix_shades(count)
    curves = draw_routes([(f"recording {n}", colour, road) for n, colour in enumerate(colours)])
    (picture,) = draw_world([Drawing((), curves)], opaque=True)
    with Image.open(io.BytesIO(picture)) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    below_legend = pixels[len(pixels) // 3 :]
    for colour in colours:
        shade = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
        assert np.count_nonzero(np.abs(below_legend - shade).max(axis=2) < 12) > 200
