"""A Dask cluster: whatever happens to its workers, a run ends with the bytes of one process or with one clear line."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.clusters import Cluster, at, cluster, fatal, full_disk, meet, slow_sum
from support.commands import INSTALLED, list_processes, mqslam

from mqslam.errors import ClusterError
from mqslam.execution import cluster as cluster_module
from mqslam.execution.cluster import connect
from mqslam.execution.folders import CHECKPOINT
from mqslam.execution.local_engine import HERE, LocalEngine
from mqslam.simulator import SensorModel, simulate

SAME = "trajectory.tum odometry.tum measurements.csv covariances.csv graph.g2o map.ply map.pgm config.yaml"


@pytest.fixture(scope="module")
def alone(lap: Path) -> Path:
    """What one process makes of the lap."""
    assert run(lap, lap / "alone", "--jobs", "1").code == 0
    return lap / "alone"


def run(lap: Path, out: Path, *more: object):
    options = ("--odometry", "none", "--config", lap / "quick.yaml", "--quiet")
    return mqslam("run", lap / "drive", "--out", out, *options, *map(str, more))


def test_what_a_killed_worker_had_to_do_is_done_by_another(crew: Cluster) -> None:
    def kill(number: int, result: int) -> None:
        crew.workers[0].kill()

    with connect(crew.address) as engine:
        assert engine.map(slow_sum, [1, 2], range(8), kill) == [3 + k for k in range(8)]


@pytest.mark.slow
def test_a_worker_killed_while_loops_are_verified_changes_no_byte(
    lap: Path, alone: Path, crew: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = at(monkeypatch, "loops", crew.workers[0].kill)
    shown = run(lap, tmp_path / "out", "--cluster", crew.address)
    assert (shown.code, shown.err) == (0, "")
    assert left[0] >= 3 and crew.workers[0].wait() == -signal.SIGKILL and crew.workers[1].poll() is None
    for name in SAME.split():
        assert (tmp_path / "out" / name).read_bytes() == (alone / name).read_bytes(), name


def test_workers_that_are_all_gone_are_not_waited_for_forever(crew: Cluster) -> None:
    def kill(number: int, result: int) -> None:
        for worker in crew.workers:
            worker.kill()

    with connect(crew.address) as engine, pytest.raises(ClusterError, match="has no workers left"):
        engine.map(slow_sum, [1, 2], range(20), kill)


@pytest.mark.slow
def test_what_tasks_share_is_sent_again_when_all_who_held_it_are_gone(
    crew: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    def replace(number: int, result: int) -> None:
        if number == 3:
            for worker in crew.workers:
                worker.kill()
            crew.add_worker()

    numbers: list[int] = []
    shared = list(range(100_000))  # too much to travel with every task
    monkeypatch.setattr(cluster_module, "_LOOK_S", 60.0)  # a worker takes seconds to start, more on a busy machine
    with connect(crew.address) as engine:
        results = engine.map(slow_sum, shared, range(12), lambda number, _: (numbers.append(number), replace(number, 0)))
    assert results == [sum(shared) + k for k in range(12)] and numbers == list(range(1, 13))


def test_what_a_function_raises_is_not_taken_for_the_clusters_trouble(crew: Cluster) -> None:
    with connect(crew.address) as engine, pytest.raises(OSError, match="No space left"):
        engine.map(full_disk, [], range(3))


def test_a_call_that_kills_its_process_is_its_own_failure_alone() -> None:
    assert LocalEngine(2).map_apart(fatal, [1], [-1, 5]) == [None, 6]


@pytest.mark.slow
def test_a_call_that_kills_its_process_again_and_again_is_its_own_failure_alone(tmp_path: Path) -> None:
    with cluster(tmp_path / "dask", workers=5) as workers, connect(workers.address) as engine:
        assert engine.map_apart(fatal, [1], [-1, 5]) == [None, 6]


@pytest.mark.parametrize("engine", [HERE, LocalEngine(3)])
def test_results_come_in_the_order_of_the_items(engine: LocalEngine) -> None:
    done: list[tuple[int, int]] = []
    results = engine.map(slow_sum, [1, 2], range(6), lambda *said: done.append(said))
    assert results == [3, 4, 5, 6, 7, 8] and done == list(zip(range(1, 7), results, strict=True))


@pytest.mark.slow
def test_compare_and_audit_give_the_same_on_a_cluster(lap: Path, tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    simulate(
        drive,
        duration_s=9.0,
        sensor=SensorModel(turn_rate_hz=2.0, azimuths=200, range_resolution=0.35, max_range=60.0),
        movers=0,
    )
    options = ("--config", lap / "quick.yaml", "--quiet")
    for name, where in (("here", ("--jobs", "2")), ("there", ("--cluster", "local:2"))):
        compare = ("compare", drive, "--frontends", "kiss_icp,odometry", "--odometry-only", *options)
        assert mqslam(*compare, "--out", tmp_path / name, *where).code == 0
        audit = ("audit", drive, "--trajectory", "odometry", *options)
        assert mqslam(*audit, "--out", tmp_path / f"audit-{name}", *where).code == 0
    same = ("kiss_icp/trajectory.tum", "odometry/trajectory.kitti", "overlay.png")
    assert all((tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes() for name in same)
    judged = [(tmp_path / f"audit-{name}" / "audit.csv").read_bytes() for name in ("here", "there")]
    assert judged[0] == judged[1]


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("local:0", "is not an address of a cluster; give tcp://host:port"),
        ("local", "is not an address of a cluster; give tcp://host:port"),
        ("127.0.0.1:8786", "is not an address of a cluster; give tcp://host:port"),
        ("tcp://127.0.0.1:9", "no scheduler answers there; start one with 'dask scheduler'"),
    ],
)
def test_an_address_that_leads_nowhere_is_said(
    lap: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str, message: str
) -> None:
    monkeypatch.setattr(cluster_module, "_ANSWER_S", 1.0)
    shown = run(lap, tmp_path / "out", "--cluster", address)
    assert shown.code == 2 and message in shown.err and shown.err.count("\n") == 1, shown.err
    assert list(tmp_path.iterdir()) == []


def test_a_scheduler_without_workers_is_said(lap: Path, tmp_path: Path) -> None:
    with cluster(tmp_path / "dask", workers=0) as crew:
        shown = run(lap, tmp_path / "out", "--cluster", crew.address)
    assert shown.err == f"mqslam: error: {crew.address}: has no workers; start some with 'dask worker {crew.address}'\n"


def test_workers_of_another_version_are_refused(tmp_path: Path, lap: Path) -> None:
    other = tmp_path / "other" / "mqslam"
    (other / "execution").mkdir(parents=True)
    (other / "__init__.py").touch()
    (other / "execution" / "__init__.py").touch()
    (other / "execution" / "cluster.py").write_text("def _version():\n    return '0.0.1'\n")
    with cluster(tmp_path / "dask", workers=0) as workers:
        workers.add_worker(finds=other.parent)
        shown = run(lap, tmp_path / "out", "--cluster", workers.address)
    assert shown.code == 2 and "has mqslam 0.0.1; install" in shown.err and shown.err.count("\n") == 1, shown.err


def test_without_dask_only_the_cluster_is_missing(lap: Path, tmp_path: Path) -> None:
    """Dask hidden, in a process of its own."""
    program = f"""
import sys
sys.modules["dask"] = sys.modules["distributed"] = None
import mqslam.commands.batch, mqslam.results.batch_results, mqslam.comparison.judgement, mqslam.commands.run
from mqslam.cli import main
sys.argv = ["mqslam", "run", {str(lap / "drive")!r}, "--out", {str(tmp_path / "out")!r}, "--cluster", "local:2", "--quiet"]
main()
"""
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert shown.returncode == 2 and "[cluster]'" in shown.stderr and shown.stderr.count("\n") == 1


@pytest.mark.slow
def test_an_interrupt_leaves_no_process_and_what_can_be_resumed(lap: Path, tmp_path: Path) -> None:
    words = ["run", lap / "drive", "--out", tmp_path / "out", "--odometry", "none", "--cluster", "local:2"]
    process = subprocess.Popen(
        [INSTALLED, *words],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # what runs the tests may ignore it
    )
    assert process.stderr is not None
    while not (line := process.stderr.readline()).startswith("reading and detecting: 104/104"):
        assert line
    process.send_signal(signal.SIGINT)
    rest = process.stderr.read()
    assert process.wait(timeout=300) == 130 and rest.splitlines()[-1] == "mqslam: interrupted; continue with --resume"
    assert "Traceback" not in rest and {path.name for path in (tmp_path / "out").iterdir()} == {CHECKPOINT}
    assert list_processes(process.pid) == []


def listening_ports() -> set[str]:
    """Returns the ports of all networks on which a process of this machine listens."""
    lines = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    return {words[1] for words in lines if words[3] == "0A"}


def test_no_network_reaches_the_workers_of_this_machine() -> None:
    before = listening_ports()
    with connect("local:2") as engine:
        assert engine.map(slow_sum, [1, 2], range(8), lambda *_: None) == [3 + k for k in range(8)]
        assert listening_ports() <= before


def test_workers_of_this_machine_make_several_calls_apart_at_a_time(tmp_path: Path) -> None:
    done: list[tuple[int, int | None]] = []
    with connect("local:3") as engine:
        assert engine.jobs == 1
        started: list[int] = []
        results = engine.map_apart(meet, (tmp_path, 3), [0, 1, 2], lambda *said: done.append(said), started.append)
        assert results == sorted(started) == [0, 1, 2]
        assert engine.map_apart(fatal, [1], [-1, 5]) == [None, 6]
    assert done == [(1, 0), (2, 1), (3, 2)]
