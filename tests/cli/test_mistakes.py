"""A mistake that a user can mend is one line on stderr and exit code 2, whatever the command, and changes nothing."""

from __future__ import annotations

from pathlib import Path

import gtsam
import pytest
from support.commands import mqslam, read_contents
from support.recordings import START_US, TURN_US, write_oxford

from mqslam.formats.graphs.g2o import format_poses_and_edges

END_US = START_US + 6 * TURN_US
NO_PLANS = {
    "runs: [{dta: drive}]": "run 1: unknown key dta; did you mean data?",
    "rnus: []": "unknown key rnus; give only a list of runs in the form 'runs: [{data: RECORDING}, {data: ANOTHER}]'",
    "runs: []": "must hold a list of runs in the form 'runs: [",
    "runs: [{name: drive}]": "run 1 (drive): data: is missing",
    "runs: [drive]": "run 1: must be in the form '- {data: RECORDING}', but it is 'drive'",
    "runs: [{data: drive}, {data: drive, name: b, range_resolution: 0.04}]": (
        "run 2 (b): unknown key range_resolution; if you mean this setting, give it as 'set: {sensor.range_"
    ),
    "runs: [{data: drive}, {data: drive}]": "run 2: name drive: is the name of another run too; give one",
    "runs: [{data: drive, name: ../up}]": "run 1 (../up): name '../up': cannot be the name of a folder",
    "runs: [{data: drive, frontend: kissicp}]": "run 1: front end kissicp: unknown; did you mean kiss_icp?",
    "runs: [{data: drive, config: oxfrod}]": "oxfrod: no such configuration and no such file; did you mean oxford?",
    "runs: [{data: drive, frame: car}]": "run 1: frame: must be 'radar' or 'vehicle'",
    "runs: [{data: drive, extrinsics: '1.2,0'}]": "run 1: extrinsics 1.2,0: are not three numbers",
    "runs: [{data: drive, start: soon}]": "run 1: start: must be a valid number",
    "runs: [{data: drive, start: 9, end: 9}]": "run 1: start 9.0 and end 9.0: the end must be later than the start",
    "runs: [{data: drive, set: {detector: {threshold: 9}}}]": "run 1: set detector: give SECTION.NAME: VALUE, such as",
    "runs: [{data: drive, set: {detector.treshold: 9}}]": "unknown setting detector.treshold; did you mean threshold?",
    "runs: [": "is not a readable YAML file",
    "- drive": "must hold a list of runs in the form 'runs: [",
}
ODOMETRY = {
    f"t,v,omega\n{START_US + 700_000},1,0\n{END_US},1,0\n": (
        f"which does not cover the recording; give odometry that spans {START_US} to"
    ),
    f"t,v,omega\n{START_US},1,0\n{START_US + 500_000},1,0\n": "which does not cover the recording",
}
SMALL = "simulate drive --duration 1.5 --azimuths 90 --range-resolution 0.5 --max-range 60"
KEPT = {"kept.bag": "kept", "kept/mine": "kept"}
GRAPHS = {"poses.tum": "# a trajectory\n1600000000.022921 0 0 0 0 0 0 1\n", "table.txt": "1 2 3\n", "prose.txt": "Poses.\n"}
DAMAGED = '{"warnings": [], "verdict": {"status": "good"}, "tests": {}}'
FAIL_ON = (
    "give warn (exits with 1 if the verdict is warn or fail) or fail (exits with 1 if the verdict is fail); both exit with "
    "3 if the map could not be judged"
)
FROM_FILE = "can be given only together with a trajectory from a file"

# the words of a command, in which OXFORD is a small recording and STREET a simulated one, what it says, and files beside it
MISTAKES: list[tuple[str, str, dict[str, str]]] = [
    ("run nowhere --out out", "nowhere: does not exist", {}),
    ("run OXFORD --out out --config s.yaml", "unknown setting detecter; did you mean detector?", {"s.yaml": "detecter: {}"}),
    ("run OXFORD --out out --config nothing.yaml", "nothing.yaml: no such configuration", {}),
    ("run OXFORD --out out --frontend kiss_ipc", "front end kiss_ipc: unknown; did you mean kiss_icp?", {}),
    ("run OXFORD --out out --format oxfrod", "did you mean oxford?", {}),
    ("run OXFORD --out out --range-resolution -1", "cannot be the length", {}),
    ("run OXFORD --out out --range-resolution 0", "cannot be the length", {}),
    ("run OXFORD --out out --odometry nothing.csv", "nothing.csv: does not exist", {}),
    *(("run OXFORD --out out --odometry w.csv", said, {"w.csv": text}) for text, said in ODOMETRY.items()),
    ("run OXFORD --out out --frontend odometry --odometry none", "needs odometry", {}),
    ("run OXFORD --out out --frontend mine.py", "front end mine.py: there is no such file; check the path", {}),
    ("compare OXFORD --out out --frontends ./mine.py", "give mine.py, and compare in the folder .", {"mine.py": ""}),
    ("run OXFORD --out out --imu nowhere.csv", "nowhere.csv: does not exist", {}),
    ("run OXFORD --out out --gnss nowhere.csv", "nowhere.csv: does not exist", {}),
    ("run OXFORD --out out --extrinsics 1,2", "extrinsics 1,2: are not three numbers; give --extrinsics as metres", {}),
    (
        "run OXFORD --out out --frame vehicle",
        "sits on it; give --extrinsics X,Y,YAW, or --frame radar: if there is odometry, a run then",
        {},
    ),
    ("run OXFORD --out out --frame vehicle --extrinsics none", "nothing says where the radar sits on it", {}),
    ("run OXFORD --out out --frame vehicel --extrinsics 1,0,0", "frame vehicel: unknown; did you mean vehicle?", {}),
    ("run STREET --out out --start 900", "no scan begins in it; the scans begin from 0.0 s to 11.", {}),
    ("run OXFORD --out file/out", "cannot be made", {"file": "kept"}),
    ("run OXFORD --out kept", "kept: exists already; choose another --out", KEPT),
    ("run OXFORD --out kept.bag", "kept.bag: exists already; choose another --out", KEPT),
    ("run OXFORD --out drive --force", "choose another --out", {}),
    ("run OXFORD --out . --force", "choose another --out", {}),
    ("run OXFORD --out HERE --force", "choose another --out", {}),
    ("audit STREET --out out", "trajectory of its own (it carries odometry, ground_truth); give --trajectory FILE", {}),
    ("audit STREET --out kept -t ground_truth", "kept: exists already", KEPT),
    ("audit STREET --out out -t nowhere.tum", "nowhere.tum: ", {}),
    ("audit STREET --out out -t ground_trut", "does not exist; check the path, or did you mean ground_truth?", {}),
    ("audit STREET --out out --time-offset 2.5", f"offset and extrinsics {FROM_FILE}; give --trajectory FILE", {}),
    ("audit STREET --out out --extrinsics 0,0,1", f"offset and extrinsics {FROM_FILE}; give --trajectory FILE", {}),
    ("audit STREET --out out --frame base_link", f"offset and extrinsics {FROM_FILE}; give --trajectory FILE", {}),
    ("audit STREET --out out -t ground_truth --time-offset 2.5", FROM_FILE, {}),
    ("audit STREET --out out -t odometry --times t.txt", FROM_FILE, {}),
    ("audit STREET --out out -t ground_truth --extrinsics 0,0,1", f"{FROM_FILE}; give --trajectory", {}),
    ("audit STREET --out out -t odometry --frame base_link", f"{FROM_FILE}; give --trajectory", {}),
    ("audit STREET --out out --covariances c.csv", f"covariances {FROM_FILE}; give --trajectory FILE", {}),
    ("audit STREET --out out -t ground_truth --covariances c.csv", FROM_FILE, {}),
    ("run STREET --out out --fail-on pass", FAIL_ON, {}),
    ("audit STREET --out out --fail-on WARN", f"--fail-on WARN: {FAIL_ON}", {}),
    ("audit STREET --out out -t TRUTH --covariances c.csv", "c.csv: does not begin with the columns", {"c.csv": "t,x\n"}),
    ("audit STREET --out out -t TRUTH --baseline old", "old: does not exist", {}),
    ("audit STREET --out out -t TRUTH --baseline old", "old/audit.json: ", {"old/audit.json": DAMAGED}),
    ("audit STREET --out out -t ground_truth --config nothing", "no such configuration", {}),
    ("audit STREET --out out -t ground_truth --false-alarms 0", "a rate of false alarms of 0 is not between 0 and 0.5", {}),
    ("audit STREET --out out -t ground_truth --false-alarms 0.5", "alarms of 0.5 is not between 0 and 0.5", {}),
    ("audit STREET --out out -t ground_truth --false-alarms nan", "alarms of nan is not between 0 and 0.5", {}),
    ("audit STREET --out out -t TRUTH --extrinsics 1,2", "1,2: are not three numbers; give --extrinsics as metres", {}),
    ("audit STREET --out out -t TRUTH --extrinsics 1,2,left", "extrinsics 1,2,left: are not three numbers", {}),
    ("audit STREET --out out -t TRUTH --extrinsics 1500,0,0", "extrinsics of 1500, 0, 0 are not a pose on a vehicle", {}),
    ("audit STREET --out out -t TRUTH --extrinsics 0,0,nan", "extrinsics of 0, 0, nan are not a pose on a vehicle", {}),
    ("audit STREET --out out -t TRUTH --frame base_link", "is no bag, and holds neither topics nor frames", {}),
    ("audit map.ply --out out -t t.tum --start 1", "map.ply: only a recording can be audited in part", {"map.ply": "ply\n"}),
    ("compare STREET --out out --frontends psi,kis_icp", "front end kis_icp: unknown; did you mean kiss_icp?", {}),
    ("compare STREET --out out --frontends psi,psi", "each name once", {}),
    ("compare STREET --out out --frontends psi+gps", "+gyro is the only sensor that can be added; name psi or psi+gyro", {}),
    ("compare STREET --out out --frontends psi+gyro --imu none", "is switched off; give --imu auto", {}),
    ("compare STREET --out out --tolerance 0", "a tolerance of 0 m is not a length above 0", {}),
    ("compare STREET --out out --trajectory mine", "give NAME=FILE", {}),
    ("compare STREET --out out --trajectory ../mine=a.tum", "cannot be the name of a folder", {"a.tum": ""}),
    ("compare STREET --out out --trajectory psi=a.tum", "there is a row psi already", {}),
    ("compare STREET --out out --trajectory mine=nowhere.tum", "nowhere.tum", {}),
    ("check nowhere", "nowhere: does not exist", {}),
    ("info nowhere", "nowhere: does not exist", {}),
    ("info .", ".: ", {"notes.txt": "hello"}),
    ("convert nowhere out.bag", "nowhere: does not exist", {}),
    ("convert notes out", "notes: is no recording in a known layout", {"notes/notes.txt": "hello"}),
    (
        "info notes",
        "a planar lidar's recording is a CARMEN log (.log or .clf, also .gz) or a bag with ",
        {"notes/notes.txt": "hi"},
    ),
    ("convert OXFORD out.png", "out.png: no layout has the suffix '.png'; end it in .bag, .mcap or .npz", {}),
    ("convert OXFORD out --to borea", "layout 'borea': is unknown; did you mean boreas?", {}),
    ("convert OXFORD out.bag --to mcap", "out.bag: mcap is a file that ends in .mcap", {}),
    ("convert OXFORD out --to native", "out: native is a file that ends in .npz", {}),
    ("convert OXFORD kept.bag", "kept.bag: exists already; choose another OUT or give --force", KEPT),
    ("convert OXFORD kept", "kept: exists already", KEPT),
    ("convert OXFORD kept --to rosbag2", "kept: exists already", KEPT),
    ("convert OXFORD kept.bag/out.npz", "kept.bag/out.npz: cannot be made", KEPT),
    ("convert OXFORD drive --to boreas --force", "drive: holds the recording", {}),
    ("convert OXFORD . --to boreas --force", "choose another", {}),
    ("simulate kept --duration 1.5", "kept: exists already", KEPT),
    (f"{SMALL} --scene moon", "moon", {}),
    (f"{SMALL} --scene queue", "queue", {}),
    (f"{SMALL} --seed -1", "", {}),
    (f"{SMALL} --scene corridor --movers 2", "", {}),
    ("score STREET --start 99 --motion 1,0", "no 3 scans begin at 99 s", {}),
    ("score STREET --start -1 --motion 1,0", "no 3 scans begin at -1 s", {}),
    ("score STREET --start nan --motion 1,0", "give a start of 0 to 11.25", {}),
    ("score STREET --start 0 --motion 1,0 --revolutions 500", "holds only 48", {}),
    ("score STREET --start 0 --motion 1", "--motion 1: is not a motion; give v,omega or vx,vy,omega", {}),
    ("score STREET --start 0 --motion 1,2,3,4", "is not a motion", {}),
    ("score STREET --start 0 --motion fast,0", "--motion fast,0: is not a motion", {}),
    ("score STREET --start 0 --motion nan,0", "is not a motion", {}),
    ("score STREET --start 0 --motion 1,0 --unmatched inf", "--unmatched inf: unmatched: must be a finite number", {}),
    ("score STREET --start 0 --motion 1,0 --unmatched nan", "--unmatched nan: unmatched: must be a finite number", {}),
    (
        "score STREET --start 0 --motion 1,0 --temporal box",
        "error: --temporal box: temporal: must be 'plateau' or 'gaussian'",
        {},
    ),
    ("score STREET --start 0 --motion 1,0 --numerator 2", "error: --numerator 2: numerator: must be ", {}),
    ("score STREET --start 0 --motion 1,0 --unmatched -1", "error: --unmatched -1.0: unmatched: must be ", {}),
    ("optimise none.g2o", "none.g2o: does not exist; check the path", {}),
    (
        "optimise poses.tum",
        "poses.tum: is no g2o graph, but looks like a trajectory; give a graph of VERTEX_SE2 and",
        GRAPHS,
    ),
    ("optimise table.txt", "table.txt: is no g2o graph, but looks like a table of numbers; give a graph of", GRAPHS),
    ("optimise prose.txt", "prose.txt: is no g2o graph; give a graph of", GRAPHS),
    ("optimise GRAPH --out poses.csv", "poses.csv: has an unknown suffix; give an output that ends in one of .g2o", {}),
    ("optimise GRAPH --out graph.g2o", "graph.g2o: exists already; choose another --out or give --force to replace it", {}),
    ("optimise GRAPH --out none/poses.g2o", "none/poses.g2o: cannot be written", {}),
    ("optimise GRAPH --out other.tum", "graph.g2o: has no trajectory.tum beside it", {}),
    ("optimise GRAPH --values graph.g2o", "graph.g2o: is not needed: graph.g2o holds its own values; leave it out", {}),
    ("optimise SERIALISED --values none.txt", "none.txt: does not exist; check the path", {}),
    ("optimise SERIALISED", "graph.txt: is a graph that GTSAM has written, without its values; give --values FILE", {}),
    *(("batch runs.yaml --out out", said, {"runs.yaml": text}) for text, said in NO_PLANS.items()),
    ("localise STREET --map nowhere --out out", "nowhere", {}),
]


def write_graphs() -> None:
    """Writes a graph of two poses as g2o and as GTSAM does."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(1.0, 0.0, 0.0), gtsam.noiseModel.Isotropic.Sigma(3, 0.1)))
    for key in range(2):
        values.insert(key, gtsam.Pose2(1.1 * key, 0.0, 0.0))
    Path("graph.g2o").write_text(format_poses_and_edges(graph, values, range(2)))
    Path("graph.txt").write_text(graph.serialize())


@pytest.mark.parametrize(("words", "said", "files"), MISTAKES)
def test_a_mistake_is_one_line_and_changes_nothing(
    street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, said: str, files: dict[str, str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in files.items():
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(text)
    if "OXFORD" in words:
        write_oxford(Path("drive"))
    if words.startswith("optimise"):
        write_graphs()
    before = read_contents(tmp_path)
    known = {"OXFORD": "drive", "STREET": street, "TRUTH": street / "gt" / "poses_tum.txt"}
    known |= {"GRAPH": "graph.g2o", "SERIALISED": "graph.txt", "HERE": tmp_path}
    shown = mqslam(*(known.get(word, word) for word in words.split()), *([] if words.startswith("optim") else ["--quiet"]))
    assert (shown.code, shown.out) == (2, ""), shown
    assert shown.err.startswith("mqslam: error: ") and shown.err.count("\n") == 1 and said in shown.err, shown.err
    assert read_contents(tmp_path) == before
