"""Messages count one thing and several things."""

from __future__ import annotations

import pytest

from mqslam.core.wording import count_of, is_or_are


@pytest.mark.parametrize(("number", "text"), [(0, "0 scans are"), (1, "1 scan is"), (2, "2 scans are")])
def test_one_is_singular_and_all_else_plural(number: int, text: str) -> None:
    assert f"{count_of(number, 'scan')} {is_or_are(number)}" == text
