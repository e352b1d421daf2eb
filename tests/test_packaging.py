"""A wheel installs one import package, with its data, and nothing beside it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from configparser import ConfigParser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PARTS = ("mqslam", "frontends", "factors", "configs")
SOURCES = ("pyproject.toml", "README.md", "LICENSE", ".ci/backend", *PARTS)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """The wheel of a copy of the sources, so that nothing left by earlier builds gets in."""
    folder = tmp_path_factory.mktemp("sources")
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, folder / name)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder / "out", folder]
    built = subprocess.run(command, capture_output=True, text=True)
    if "No matching distribution found for setuptools" in built.stderr:
        pytest.skip("the build needs setuptools from the package index, which cannot be reached")
    assert built.returncode == 0, built.stderr
    (result,) = (folder / "out").glob("mqslam-*.whl")
    return zipfile.ZipFile(result)


def test_every_package_is_listed() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    folders = {name: settings["package-dir"].get(name, name.replace(".", "/")) for name in settings["packages"]}
    there = {path.parent for part in PARTS for path in (ROOT / part).rglob("*.py")}
    assert {ROOT / folder for folder in folders.values()} == there


@pytest.mark.slow
def test_nothing_but_mqslam_lands_in_site_packages(wheel: zipfile.ZipFile) -> None:
    tops = {name.split("/")[0] for name in wheel.namelist()}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"mqslam"}


@pytest.mark.slow
def test_every_module_and_configuration_is_in_the_wheel(wheel: zipfile.ZipFile) -> None:
    expected = {
        (f"mqslam/{path.relative_to(ROOT)}" if part != "mqslam" else str(path.relative_to(ROOT)))
        for part in PARTS
        for path in (ROOT / part).rglob("*")
        if path.suffix in (".py", ".yaml", ".typed", ".html", ".css", ".js") or path.name == "LICENSE"
        if "__pycache__" not in path.parts
    }
    assert {"mqslam/frontends/psi.py", "mqslam/factors/between.py", "mqslam/configs/oxford.yaml"} <= expected
    assert {name for name in wheel.namelist() if ".dist-info/" not in name} == expected


@pytest.mark.slow
def test_the_command_and_the_front_ends_are_registered(wheel: zipfile.ZipFile) -> None:
    (name,) = (name for name in wheel.namelist() if name.endswith("entry_points.txt"))
    entries = ConfigParser()
    entries.read_string(wheel.read(name).decode())
    assert entries["console_scripts"]["mqslam"] == "mqslam.cli:main"
    assert {"psi", "odometry", "kiss_icp"} <= set(entries["mqslam.frontends"])
    for target in entries["mqslam.frontends"].values():
        assert target.split(":")[0].replace(".", "/") + ".py" in wheel.namelist()


def test_image_and_pixi_use_a_python_that_is_supported_and_the_command_that_is_installed() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    supported = {name.rpartition(" ")[2] for name in project["classifiers"] if ":: Python :: 3." in name}
    image = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert {line.split(":")[1].split("-")[0] for line in image.splitlines() if line.startswith("FROM ")} <= supported
    assert 'ENTRYPOINT ["mqslam"]' in image and "mqslam" in project["scripts"]
    pixi = tomllib.loads((ROOT / "pixi.toml").read_text(encoding="utf-8"))
    lowest, above = pixi["dependencies"]["python"].split(",")
    assert lowest == project["requires-python"] and above.removeprefix("<") not in supported
    assert pixi["pypi-dependencies"]["mqslam"]["path"] == "."


def test_a_clone_in_the_working_directory_does_not_hide_the_package(tmp_path: Path) -> None:
    (tmp_path / "mqslam" / "docs").mkdir(parents=True)  # a clone holds no __init__.py, and Python takes it for a package
    program = "import mqslam, mqslam.frontends.psi; print(mqslam.load_config().map.cell_m, mqslam.__file__)"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("0.2 ") and str(tmp_path) not in done.stdout


@pytest.mark.slow
def test_type_checkers_see_the_installed_package_from_outside(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "import mqslam\nfrom mqslam.frontends.psi import PsiFrontEnd\n\n"
        'length: str = mqslam.read_result("out").folder\nreveal_type(mqslam.load_config())\nreveal_type(PsiFrontEnd)\n'
    )
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "MYPYPATH")}
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), "mine.py"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    shown = [line for line in done.stdout.splitlines() if line.startswith("mine.py")]
    assert len(shown) == 3, done.stdout + done.stderr
    assert 'expression has type "Path", variable has type "str"' in shown[0]
    assert "mqslam.config.Config" in shown[1] and "mqslam.frontends.psi.PsiFrontEnd" in shown[2]
