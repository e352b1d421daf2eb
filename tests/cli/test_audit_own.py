"""`mqslam audit --test`: a test of a map that a user wrote judges the map, too."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.commands import mqslam

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "map-test.md"
CODE = PAGE.read_text().split("```python\n")[1].split("```")[0]
WORDS = ("--trajectory", "ground_truth", "--quiet")


def test_the_test_on_the_page_passes_and_fails_with_its_limit(street: Path, quick: Path, tmp_path: Path) -> None:
    for speed, status in (("25.0", "pass"), ("0.5", "fail")):
        file, out = tmp_path / "top_speed.py", tmp_path / status
        file.write_text(CODE.replace("25.0", speed))
        result = mqslam("audit", street, "--out", out, *WORDS, "--test", file, "--config", quick)
        assert (result.code, result.err) == (0, "")
        assert "--mend" not in result.out  # it mends nothing that such a test finds
        summary = json.loads((out / "audit.json").read_text())
        assert summary["tests"]["top_speed"]["status"] == summary["verdict"]["status"] == status
        if status == "fail":
            assert "faster than this vehicle can" in summary["verdict"]["diagnosis"]
        page = (out / "report.html").read_text()
        assert "top_speed: the speed of the trajectory with the top speed of the vehicle" in page and "slow errors" in page


@pytest.mark.parametrize(
    "code, said",
    [
        (CODE.replace("judge=judge", ""), "defines 0 MapTest objects with a function judge; define exactly one"),
        (CODE + "OTHER = MapTest('b', '', '', judge=judge)\n", "defines 2 MapTest objects"),
        (CODE.replace("top_speed", "spans"), "mqslam has a test of the name spans; choose another name"),
        ("import absent_module", "cannot be imported (ModuleNotFoundError: No module named 'absent_module'); mend the file"),
        (CODE.replace("np.max", "np.absent"), "test top_speed: stopped with"),
        (CODE.replace("return [Finding", "return [str"), "returned something other than Finding objects"),
    ],
)
def test_a_wrong_file_is_an_error_that_says_what_to_mend(
    street: Path, quick: Path, tmp_path: Path, code: str, said: str
) -> None:
    file = tmp_path / "wrong.py"
    file.write_text(code.replace("VerdictStatus.PASS, ", "") if "[str" in code else code)
    result = mqslam("audit", street, "--out", tmp_path / "a", *WORDS, "--test", file, "--config", quick)
    assert result.code == 2 and said in result.err and "Traceback" not in result.err
    assert not (tmp_path / "a").exists()


def test_a_missing_file_is_named(street: Path, tmp_path: Path) -> None:
    result = mqslam("audit", street, "--out", tmp_path / "a", *WORDS, "--test", tmp_path / "absent.py")
    assert result.code == 2 and "absent.py: there is no such file; check the path" in result.err
