"""Reads finished point clouds (maps) with a time per point, from PLY, PCD, LAS, LAZ and NPZ files."""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core.point_map import TimedCloud
from mqslam.core.wording import count_of, join_words
from mqslam.errors import DataError, MqslamError, untrusted
from mqslam.execution.extras import describe_missing
from mqslam.execution.guards.apart import ProcessFailed, call_apart
from mqslam.formats import npz
from mqslam.formats.ply import read_clock
from mqslam.formats.poses import mark_places
from mqslam.formats.stamps import LATEST_US, UNITS, convert_stamps, guess_unit, time_unit
from mqslam.formats.tables import find_stamps

_WANTED = "a cloud needs x, y and one of time, t, timestamp, stamp or gps_time for every point"
_COARSEST_S = 0.05  # a file with coarser time steps is refused, because they cannot tell one scan from the next
_NOTED_S = 1e-3  # finer time steps than this do not matter for a map and get no note
_YEAR_US = 365.25 * 86400e6
_LONGEST_US = 10 * _YEAR_US  # longer spans of time are damaged, and would make an audit judge a huge number of windows
_MOST_NUMBERS = 10_000  # limit on the numbers per point that a header may claim
Columns = Mapping[str, Any]  # the values (N,) of each field of a cloud, by the name of the field
_RECORD_BYTES, _COMPRESSED = 54, 0x80  # of LAS: bytes of a variable-length record's header; flag of compressed points
_ALWAYS_BYTES: Final = 1 << 30  # limit on the memory of the Python process itself, besides the points; it uses far less
_COPIES: Final = 4  # copies of the points that are in memory at a time while they are unpacked and written


@untrusted.reads_file
def read_cloud(path: Path, z_range: tuple[float, float] | None = None) -> TimedCloud:
    """Reads a cloud, such as the `map.ply` of a run, as points in the plane in the order of their times.

    Times are in the unit that the field's name ends in (t_us). Without a unit in the name the largest time decides: it is in
    nanoseconds above 1e17, in microseconds above 1e14, in milliseconds above 1e11, else in seconds. A field of seconds and
    one of nanoseconds are joined. Points whose coordinates or time are not finite are left out. Comments in the `map.ply` of
    a run state how long a scan takes and whether the sensor is a lidar; in older files they also state the stamp from which
    times are counted.

    Args:
        path: a `.ply`, `.pcd`, `.las`, `.laz` or `.npz` with fields x, y [m] and a time. In an `.npz` x and y may be the
            columns of an array points (N, 2) or (N, 3).
        z_range: lowest and highest z [m] to keep; None keeps every point, whatever its z.

    Raises:
        DataError: the file cannot be read, has no times or no points, or lacks the z that `z_range` needs.
    """
    load = _LOADERS.get(path.suffix.lower())
    if load is None:
        raise DataError(path, "is no cloud in a known format", f"give a file of one of these kinds: {', '.join(_LOADERS)}")
    try:
        columns = load(untrusted.check_file(path))
        clock = read_clock(path) if load is _load_ply else None
    except MqslamError:
        raise
    except Exception as error:  # each library raises errors of its own besides NumPy's and the system's
        reason = (getattr(error, "strerror", None) or str(error) or type(error).__name__).splitlines()[0][:160]
        raise DataError(path, f"is not a readable {path.suffix} ({reason})", "write the file again") from error
    cloud = _make_cloud(path, columns, z_range)
    if clock is None:
        return cloud
    if clock.start_us + int(cloud.stamps_us[-1]) > LATEST_US:
        raise DataError(path, f"counts its times from {clock.start_us} us, a stamp beyond any clock", "write the file again")
    notes = [f"times are counted from {clock.start_us} us, as the file states"] if clock.start_us else []
    return replace(
        cloud,
        stamps_us=cloud.stamps_us + clock.start_us,
        notes=(*cloud.notes, *notes),
        scan_us=clock.scan_us,
        is_of_lidar=clock.is_of_lidar,
    )


def _make_cloud(path: Path, columns: Columns, z_range: tuple[float, float] | None) -> TimedCloud:
    """Makes a cloud of a file's fields, or raises a DataError; keeps points with z in `z_range` [m], or all for None."""
    fields = [*columns]
    stamps_at = [(fields[column], unit) for column, unit in find_stamps(fields)]
    name, unit = stamps_at[0] if stamps_at else (None, "")
    if name is None or "x" not in columns or "y" not in columns:
        missing = "time per point" if name is None else "x and y"
        raise DataError(path, f"has no {missing} (fields: {', '.join([*columns][:20]) or 'none'})", _WANTED)
    if z_range is not None and "z" not in columns:
        raise DataError(path, "has no z to choose points by", "leave the range of z out")
    x, y, times = (_read_column(path, columns, field) for field in ("x", "y", name))
    if len(stamps_at) > 1:
        times = _join(times, _read_column(path, columns, stamps_at[1][0]))
        name, unit = f"{name} and {stamps_at[1][0]}", "ns"
    z = _read_column(path, columns, "z") if z_range is not None else None
    if len({len(x), len(y), len(times)}) > 1 or (z is not None and len(z) != len(x)):
        counts = [f"{len(x)} of x", f"{len(y)} of y", *([] if z is None else [f"{len(z)} of z"]), f"{len(times)} of {name}"]
        remedy = "write the file again, with one value of each field per point"
        raise DataError(path, f"has different numbers of values: {join_words(counts)}", remedy)
    notes = [_note_precision(path, name, times, unit)] if times.dtype == np.float32 and len(times) else []
    with np.errstate(invalid="ignore"):  # damaged numbers may be NaNs of a kind that NumPy warns about
        whole = mark_places(np.column_stack([x, y]).astype(np.float64)) & np.isfinite(times)
    if dropped := len(x) - int(np.count_nonzero(whole)):
        notes.append(f"{count_of(dropped, 'point')} without finite coordinates and time: left out")
    if z is not None and z_range is not None:
        whole &= (z >= z_range[0]) & (z <= z_range[1])
        notes.append(f"{np.count_nonzero(whole)} of {len(x)} points have z from {z_range[0]:g} m to {z_range[1]:g} m")
    if not whole.any():
        raise DataError(path, "holds no points", "check how it was written, and the range of z")
    try:
        stamps, unit = convert_stamps(times[whole], unit)
    except ValueError as error:
        raise DataError(path, f"{name} {error}", _WANTED) from error
    begin, end = np.quantile(stamps, [0.05, 0.95])
    if end - begin > _LONGEST_US:
        raise DataError(path, f"{name} spans {(end - begin) / _YEAR_US:.0f} years, too many", "write the file again")
    order = np.argsort(stamps, kind="stable")
    points = np.column_stack([x[whole], y[whole]]).astype(np.float64)
    notes.append(f"times are read from {name}, in {unit}")
    return TimedCloud(path, points[order], stamps[order], tuple(note for note in notes if note))


def _join(seconds: NDArray[Any], parts: NDArray[Any]) -> NDArray[Any]:
    """Joins whole seconds (N,) and their nanoseconds (N,) to times (N,) [ns].

    If an array does not hold integers, or if the lengths differ, the seconds are taken alone. Nanoseconds of 1e9 or more are
    complete times: if there are any, the nanoseconds are taken alone.
    """
    if seconds.shape != parts.shape or not all(np.issubdtype(values.dtype, np.integer) for values in (seconds, parts)):
        return np.round(seconds.astype(np.float64) * 1e9)
    if np.abs(parts).max(initial=0) >= 10**9:  # the parts are complete times already
        return parts
    return np.asarray(seconds.astype(np.int64) * 10**9 + parts.astype(np.int64))


def _read_column(path: Path, columns: Columns, name: str) -> NDArray[Any]:
    """Returns the values (N,) of a field, or raises a DataError if the field does not hold one number per point."""
    column: NDArray[Any] = np.asarray(columns[name])
    if column.ndim != 1 or column.dtype.kind not in "iuf":
        raise DataError(path, f"{name} is {column.ndim}-dimensional {column.dtype}, not a number per point", _WANTED)
    return column


def _note_precision(path: Path, name: str, times: NDArray[np.float32], unit: str) -> str:
    """Returns a note on the smallest step between single-precision times (N,), or "" if the step is small.

    The times are in `unit`; if it is "", it is guessed from their size.

    Raises:
        DataError: the step is too large to tell one scan from the next.
    """
    largest = np.abs(times[np.isfinite(times)]).max(initial=np.float32(0.0))
    step = float(np.spacing(largest)) * 1e-6 * float(UNITS[unit or guess_unit(float(largest))])
    if step > _COARSEST_S:
        problem = f"{name} is single-precision, in which different times are at least {step:.3g} s apart"
        raise DataError(path, problem, "write it in double precision, or count its times from the recording's start")
    return f"{name} is single-precision: times come in steps of {step:.2g} s" if step > _NOTED_S else ""


def _load_ply(path: Path) -> Columns:
    """Loads the properties (N,) of the vertices of a PLY, and returns them by name."""
    from plyfile import PlyData

    content = PlyData.read(str(path))
    if "vertex" not in content:
        raise DataError(path, "has no element vertex", _WANTED)
    vertices = content["vertex"].data
    return {name: vertices[name] for name in vertices.dtype.names}


def _load_pcd(path: Path) -> Columns:
    """Loads the fields (N,) of a PCD, and returns them by name."""
    try:
        from pypcd4.pypcd4 import MetaData, PointCloud
    except ModuleNotFoundError as error:
        raise _name_missing(path, "pcd") from error

    with path.open("rb") as file:
        lines: list[str] = []
        while len(lines) < 64 and not (lines and lines[-1].startswith("DATA")):
            lines.append(file.readline(1 << 16).decode("utf-8").strip())
        header = MetaData.parse_header(lines)
        if (
            min(header.count, default=1) < 1 or sum(header.count) > _MOST_NUMBERS
        ):  # pypcd4 would make a list of all that the header claims
            raise DataError(path, f"cannot have {sum(header.count)} numbers per point", "write the file again")
        claimed = header.points * header.build_dtype().itemsize
        if claimed > untrusted.bound_unpacked(path.stat().st_size):
            raise DataError(
                path, f"states {header.points} points, but has only {path.stat().st_size} bytes", "write the file again"
            )
    points = PointCloud.from_path(path).pc_data
    if len(points) != header.points:
        raise DataError(path, f"holds {len(points)} of {header.points} points", "copy the file again")
    return {name: points[name] for name in header.fields if name in (points.dtype.names or ())}


def _load_las(path: Path) -> Columns:
    """Loads the dimensions (N,) of a LAS or LAZ, and returns them by name; x, y and z are in metres."""
    try:
        import laspy
        import lazrs  # noqa: F401 - which laspy looks for only once it unpacks points
    except ModuleNotFoundError as error:
        raise _name_missing(path, "las") from error

    with unpack(path) as unpacked, laspy.open(unpacked, read_evlrs=False) as file:
        count, cloud = file.header.point_count, file.read()
    if len(cloud.points) != count:
        raise DataError(path, f"holds {len(cloud.points)} of {count} points", "copy the file again")
    fields = [name for name in cloud.point_format.dimension_names if name not in "XYZ"]
    return {"x": cloud.x, "y": cloud.y, "z": cloud.z, **{name: cloud[name] for name in fields}}


def _name_missing(path: Path, library: str) -> DataError:
    """Returns the error that the library for clouds of a format, named by `library` (`pcd` or `las`), is not installed."""
    missing, remedy = describe_missing(library)
    return DataError(path, f"cannot be read here, since {missing}", remedy)


def _load_npz(path: Path) -> Columns:
    """Loads the arrays of an `.npz` that a cloud needs, by name; all other names map to (), so that errors can list them."""
    with npz.open_npz(path, _WANTED) as archive:
        names = npz.list_arrays(archive)
        wanted = [name for name in names if name in ("x", "y", "z") or time_unit(name) is not None]
        columns = {name: npz.read_array(archive, name) for name in wanted}
        others = {name: () for name in names if name not in columns}
        if "points" in others:
            points = npz.read_array(archive, "points")
            if points.ndim != 2 or points.shape[1] not in (2, 3):
                raise DataError(path, f"has points of shape {points.shape}", "give points (N, 2) or (N, 3)")
            columns.update(zip("xyz", points.T, strict=False))
    return {**columns, **others}


_LOADERS: dict[str, Callable[[Path], Columns]] = {
    ".ply": _load_ply,
    ".pcd": _load_pcd,
    ".las": _load_las,
    ".laz": _load_las,
    ".npz": _load_npz,
}


@contextmanager
def unpack(path: Path) -> Iterator[Path]:
    """Yields the path of an uncompressed LAS file; for a LAZ it is a temporary unpacked copy, deleted when the block ends.

    Raises:
        DataError: the file is damaged, states more points than it can hold, or cannot be unpacked.
    """
    compressed, points_bytes = _read_header(path)
    if not compressed:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="mqslam-") as folder:
        copy = Path(folder) / "points.las"
        try:
            words = [str(path.absolute()), str(copy)]
            call_apart(write_unpacked, words, most_bytes=_ALWAYS_BYTES + _COPIES * untrusted.bound_unpacked(points_bytes))
        except ProcessFailed as error:
            raise DataError(path, f"is not a readable {path.suffix} ({error})", "write the file again") from error
        yield copy


def write_unpacked(words: list[str]) -> bytes:
    """Unpacks the LAZ file at the first path into a LAS file at the second path, and returns no bytes.

    `call_apart` calls this function in another process, whose memory is limited.
    """
    import laspy

    backend = laspy.LazBackend.Lazrs  # the parallel backend aborts on damaged chunks
    with laspy.open(words[0], laz_backend=backend, read_evlrs=False) as file:
        count, cloud = file.header.point_count, file.read()
    if len(cloud.points) != count:
        raise ValueError(f"holds {len(cloud.points)} of {count} points")
    cloud.write(words[1], do_compress=False)
    return b""


def _read_header(path: Path) -> tuple[bool, int]:
    """Reads from the header of a LAS or LAZ whether its points are compressed, and their unpacked size [bytes].

    Raises:
        DataError: the file has no room for the records or the points that its header states. laspy allocates memory for
            them before it reads any of them.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(255).ljust(255, b"\0")
    header_size, points_at, records = struct.unpack_from("<HII", head, 94)
    if header_size + _RECORD_BYTES * records > min(points_at, size):
        raise DataError(path, "has a damaged header", "copy the file again")
    (point_bytes, old_count), (count,) = struct.unpack_from("<HI", head, 105), struct.unpack_from("<Q", head, 247)
    is_new = head[24:26] >= b"\1\4"
    points_bytes = point_bytes * max(old_count, count if is_new else 0)
    if points_bytes > untrusted.bound_unpacked(size):
        raise DataError(path, f"states {points_bytes} bytes of points, but has only {size} bytes", "write the file again")
    return bool(head[104] & _COMPRESSED), points_bytes
