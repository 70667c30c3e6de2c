"""Foreign recordings in the common .npz layout: one clock or several IMUs, log, GNSS and reference, in pieces.

Lives here: `NpzRecording`, `Piece`, `load`, `ImportFailure`: reading and checking.
Does not live here: what becomes of a recording (importers.py), several IMUs on one clock (several_imus.py), doubts about units (units.py).
"""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from riins_core.rotation import dcm_from_euler

from .several_imus import Imu, RecordingSettings, Stacked, to_one_clock
from .units import implausible

Floats = NDArray[np.float64]

MOST_IMUS = 8
"""Direct comparison takes 24 sensors; nothing else would mind more."""
LONGEST_GAP_S = 2.0
"""A longer hole in the IMU's time parts a recording that does not number its pieces."""


class ImportFailure(ValueError):
    """A recording cannot be imported; one sentence."""


@dataclasses.dataclass(frozen=True)
class Piece:
    """A stretch of a recording without a gap; times are the recording's own.

    Attributes
    ----------
    name : number of the piece as recorded
    t, rate, force : (m,), (m, 3), (m, 3): s, rad/s, m/s^2, body FRD
    reference : (r, 10): t, lat, lon, h, vn, ve, vd, roll, pitch, yaw; NaN: not known
    log_t, log_v : (d,), (d, 3): s, m/s, FRD at the log
    gnss : (g, 7): t, lat, lon, h, vn, ve, vd
    sensors : of several IMUs: gyro (m, n), accel (m, n) along the sensing axes, valid (m, n); rate and force are then medians over the IMUs.
        None: one IMU
    """

    name: str
    t: Floats
    rate: Floats
    force: Floats
    reference: Floats
    log_t: Floats
    log_v: Floats
    gnss: Floats
    sensors: tuple[Floats, Floats, NDArray[np.bool_]] | None = None


@dataclasses.dataclass(frozen=True)
class NpzRecording:
    """A checked recording.

    Attributes
    ----------
    path : of the file
    rate_hz : samples a second of the IMU
    pieces : in order of time
    log_sigma, log_lever : (3,), m/s and m, FRD; None: not said
    gnss_sigma : (6,), m and m/s, NED; None: not said
    kind : "mean" or "instantaneous" values; "" where the recording does not say
    stacked : what was found of several IMUs, without the pieces; None: one IMU
    notes : sentences on what was left out
    """

    path: Path
    rate_hz: int
    pieces: list[Piece]
    log_sigma: Floats | None
    log_lever: Floats | None
    gnss_sigma: Floats | None
    kind: str
    stacked: Stacked | None = None
    notes: tuple[str, ...] = ()

    def reference_range_m(self) -> float:
        """Range of heights that the reference covers, m; 0 without a reference."""
        h = np.concatenate([p.reference[:, 3] for p in self.pieces])
        return float(np.ptp(h[np.isfinite(h)])) if np.isfinite(h).any() else 0.0


def load(path: str | Path, settings: RecordingSettings | None = None) -> NpzRecording:
    """Read and check a recording.

    Parameters
    ----------
    path : .npz file in the common layout: `n_imu`; `imu_t` (or `imu_t_i` for each of several), `gyro_i`, `accel_i`; optional `imu_seg`, `truth`,
        `dvl_t`, `dvl_v`, `gnss_t`, `gnss_llh`, `gnss_vned` and their `*_seg`, `dvl_std`, `dvl_lever_frd`, `gnss_std`, `C_body_imu_i` or
        `euler_deg_i`, `imu_values` (mean or instantaneous)
    settings : how several IMUs are brought together, and whether units are doubted

    Returns
    -------
    NpzRecording

    Raises
    ------
    ImportFailure
        No such file, no npz, pickled content, a missing or malformed array, values that are not finite, time that does not increase, units that
        cannot be meant.
    """
    path, settings = Path(path), settings or RecordingSettings()
    arrays = _read(path)
    count = int(_required(arrays, "n_imu", path, 0))
    if not 1 <= count <= MOST_IMUS:
        raise ImportFailure(f"{path.name}: n_imu is {count}, must be 1 .. {MOST_IMUS}")
    imus = [_imu(arrays, path, i, count) for i in range(count)]
    notes: list[str] = []
    load_pieces = _one if count == 1 else _several
    rate_hz, pieces, stacked = load_pieces(arrays, path, imus, settings, notes)
    if settings.check_units:
        _doubt_units(path, imus, pieces)
    kind = str(arrays["imu_values"]) if "imu_values" in arrays else ""
    if kind not in ("", "mean", "instantaneous"):
        raise ImportFailure(f'{path.name}: imu_values must be "mean" or "instantaneous", not "{kind}"')
    log_sigma, log_lever, gnss_sigma = (_vector(arrays, name, size, path) for name, size in (("dvl_std", 3), ("dvl_lever_frd", 3), ("gnss_std", 6)))
    return NpzRecording(path, rate_hz, pieces, log_sigma, log_lever, gnss_sigma, kind, stacked, tuple(dict.fromkeys(notes)))


def _imu(arrays: Mapping[str, NDArray[np.generic]], path: Path, i: int, count: int) -> Imu:
    """One IMU as recorded, checked."""
    own = f"imu_t_{i}"
    clock = own if own in arrays or (count > 1 and "imu_t" not in arrays) else "imu_t" if "imu_t" in arrays else own
    t = _required(arrays, clock, path, 1)
    gyro, accel = (_required(arrays, f"{name}_{i}", path, 2, (len(t), 3)) for name in ("gyro", "accel"))
    for name, array in ((clock, t), (f"gyro_{i}", gyro), (f"accel_{i}", accel)):
        _finite(name, array, path)
    if len(t) < 2:
        raise ImportFailure(f"{path.name}: {clock} has {len(t)} samples; at least two are needed")
    if float(np.median(np.diff(t))) <= 0.0:
        raise ImportFailure(f"{path.name}: {clock} does not increase")
    return Imu(t, gyro, accel, _mounting(arrays, path, i))


def _numbers(arrays: Mapping[str, NDArray[np.generic]], path: Path, name: str, t: Floats) -> NDArray[np.generic]:
    """Number of the piece of each sample."""
    numbers = arrays.get(name)
    if numbers is None:
        return np.asarray(np.concatenate([[0], np.cumsum(np.abs(np.diff(t)) > LONGEST_GAP_S)]) + 1)
    if numbers.shape != t.shape:
        raise ImportFailure(f"{path.name}: {name} has shape {numbers.shape}, imu_t {t.shape}")
    return numbers


def _one(
    arrays: Mapping[str, NDArray[np.generic]], path: Path, imus: list[Imu], settings: RecordingSettings, notes: list[str]
) -> tuple[int, list[Piece], None]:
    """Pieces of a recording of one IMU, which keeps its own samples."""
    (imu,) = imus
    interval = float(np.median(np.diff(imu.t)))
    rate_hz = round(1.0 / interval)
    if rate_hz < 1 or abs(rate_hz * interval - 1.0) > 0.001:
        raise ImportFailure(f"{path.name}: the IMU has an interval of {interval * 1e3:.3f} ms; a whole number of samples a second is needed")
    numbers = _numbers(arrays, path, "imu_seg", imu.t)
    rate, force = imu.gyro @ imu.turn.T, imu.accel @ imu.turn.T
    rows = {n: numbers == n for n in _in_order(numbers)}
    pieces = [_piece(arrays, path, n, imu.t[mine], rate[mine], force[mine], notes) for n, mine in rows.items()]
    return rate_hz, pieces, None


def _several(
    arrays: Mapping[str, NDArray[np.generic]], path: Path, imus: list[Imu], settings: RecordingSettings, notes: list[str]
) -> tuple[int, list[Piece], Stacked]:
    """Pieces of a recording of several IMUs, on the clock of the first one."""
    names = ["imu_seg" if "imu_seg" in arrays and arrays["imu_seg"].shape == imu.t.shape else f"imu_seg_{i}" for i, imu in enumerate(imus)]
    first = _numbers(arrays, path, names[0], imus[0].t)
    cuts: list[list[Imu]] = []
    for number in _in_order(first):
        begin, end = imus[0].t[first == number][[0, -1]]
        piece = []
        for i, (imu, name) in enumerate(zip(imus, names, strict=True)):
            if i == 0 or name in arrays:
                mine = _numbers(arrays, path, name, imu.t) == number
            else:
                mine = (imu.t >= begin - LONGEST_GAP_S) & (imu.t <= end + LONGEST_GAP_S)
            part = Imu(imu.t[mine], imu.gyro[mine], imu.accel[mine], imu.turn)
            if len(part.t) < 2 or (np.diff(part.t) <= 0.0).any():
                raise ImportFailure(f"{path.name}: the time of IMU {i} does not increase in piece {number}, or it has no samples there")
            piece.append(part)
        cuts.append(piece)
    try:
        stacked = to_one_clock(cuts, settings)
    except ValueError as error:
        raise ImportFailure(f"{path.name}: {error}") from None
    pieces = []
    for number, (t, gyro, accel, valid) in zip(_in_order(first), stacked.pieces, strict=True):
        turns = np.array([imu.turn for imu in imus])
        rate, force = (np.median(np.einsum("kij,mkj->mki", turns, z.reshape(len(t), -1, 3)), axis=1) for z in (gyro, accel))
        made = _piece(arrays, path, number, t, rate, force, notes)
        pieces.append(dataclasses.replace(made, sensors=(gyro, accel, valid)))
    return stacked.rate_hz, pieces, dataclasses.replace(stacked, pieces=[])


def _doubt_units(path: Path, imus: list[Imu], pieces: list[Piece]) -> None:
    references = [p.reference for p in pieces if len(p.reference)]
    for i, imu in enumerate(imus):
        reference = references[0] if references else np.zeros((0, 10))
        mine = slice(None) if not references else (imu.t >= reference[0, 0] - 1.0) & (imu.t <= reference[-1, 0] + 1.0)
        problem = implausible(imu.t[mine], imu.gyro[mine] @ imu.turn.T, imu.accel[mine] @ imu.turn.T, reference)
        if problem:
            raise ImportFailure(f"{path.name}: IMU {i}: {problem} (--no-check-units takes it as it is)")


def _read(path: Path) -> dict[str, NDArray[np.generic]]:
    if not path.exists():
        raise ImportFailure(f"{path}: no such file")
    try:
        opened = np.load(path, allow_pickle=False)
        if not isinstance(opened, np.lib.npyio.NpzFile):
            raise ImportFailure(f"{path.name} holds a single array, not the named arrays of an .npz recording")
        with opened as file:
            return {name: file[name] for name in file.files}
    except (zipfile.BadZipFile, EOFError, OSError) as error:
        raise ImportFailure(f"{path.name} is no readable .npz file: {str(error).splitlines()[0]}") from None
    except ValueError as error:
        if isinstance(error, ImportFailure):
            raise
        if "pickle" in str(error):
            raise ImportFailure(f"{path.name} holds pickled objects, which are not read: they could run code") from None
        raise ImportFailure(f"{path.name} is no readable .npz file: {str(error).splitlines()[0]}") from None
    except Exception as error:  # zlib.error and the like
        raise ImportFailure(f"{path.name} is damaged: {str(error).splitlines()[0]}") from None


def _required(arrays: Mapping[str, NDArray[np.generic]], name: str, path: Path, ndim: int, shape: tuple[int, ...] | None = None) -> Floats:
    if name not in arrays:
        raise ImportFailure(f"{path.name}: {name} is missing; it has {', '.join(sorted(arrays)) or 'nothing'}")
    return _array(arrays, name, path, ndim, shape)


def _array(arrays: Mapping[str, NDArray[np.generic]], name: str, path: Path, ndim: int, shape: tuple[int, ...] | None = None) -> Floats:
    array = arrays[name]
    if array.dtype.kind not in "fiu":
        raise ImportFailure(f"{path.name}: {name} holds {array.dtype}, not numbers")
    if array.ndim != ndim or (shape is not None and array.shape != shape):
        wanted = shape if shape is not None else f"of {ndim} dimensions"
        raise ImportFailure(f"{path.name}: {name} has shape {array.shape}, must be {wanted}")
    return array.astype(np.float64)


def _finite(name: str, array: Floats, path: Path) -> None:
    bad = ~np.isfinite(array.reshape(len(array), -1)).all(axis=1)
    if bad.any():
        raise ImportFailure(f"{path.name}: {name} has {int(bad.sum())} rows that are not finite, the first is row {int(np.argmax(bad))}")


def _vector(arrays: Mapping[str, NDArray[np.generic]], name: str, size: int, path: Path) -> Floats | None:
    if name not in arrays:
        return None
    vector = _array(arrays, name, path, 1, (size,))
    _finite(name, vector, path)
    return vector


def _mounting(arrays: Mapping[str, NDArray[np.generic]], path: Path, i: int) -> Floats:
    """C_body_imu of an IMU."""
    if (name := f"C_body_imu_{i}") in arrays:
        turn = _array(arrays, name, path, 2, (3, 3))
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) or np.linalg.det(turn) < 0.0:
            raise ImportFailure(f"{path.name}: {name} is no rotation")
        u, _, v = np.linalg.svd(turn)  # written with few digits it is not quite one
        return np.asarray(u @ v)
    if (name := f"euler_deg_{i}") in arrays:
        return np.asarray(dcm_from_euler(*np.radians(_array(arrays, name, path, 1, (3,)))))
    return np.eye(3)


def _in_order(numbers: NDArray[np.generic]) -> list[int]:
    _, first = np.unique(numbers, return_index=True)
    return [int(numbers[i]) for i in sorted(first)]


def _piece(arrays: Mapping[str, NDArray[np.generic]], path: Path, number: int, t: Floats, rate: Floats, force: Floats, notes: list[str]) -> Piece:
    if len(t) < 2 or (np.diff(t) <= 0.0).any():
        raise ImportFailure(f"{path.name}: the time of the IMU does not increase in piece {number}")

    def rows(stem: str, names: tuple[str, ...], widths: tuple[int, ...]) -> Floats:
        """Rows of this piece of arrays that belong together, side by side."""
        empty = np.zeros((0, sum(max(w, 1) for w in widths)))
        if names[0] not in arrays or not len(arrays[names[0]]):
            return empty
        length = len(arrays[names[0]])
        parts = [_required(arrays, n, path, 1 if not w else 2, (length,) if not w else (length, w)) for n, w in zip(names, widths, strict=True)]
        table = np.column_stack(parts)
        timeless, empty_rows = ~np.isfinite(table[:, 0]), np.isnan(table).all(axis=1)
        if (timeless & ~empty_rows).any():
            raise ImportFailure(f"{path.name}: row {int(np.argmax(timeless & ~empty_rows))} of {names[0]} has values but no time")
        if empty_rows.any():
            where = f"the first is row {int(np.argmax(empty_rows))}"
            notes.append(f"{int(empty_rows.sum())} empty rows of {names[0]} (NaN, the time too) are left out, {where}.")
        if f"{stem}_seg" in arrays:
            inside = arrays[f"{stem}_seg"] == number
            if inside.shape != (length,):
                raise ImportFailure(f"{path.name}: {stem}_seg has shape {inside.shape}, {names[0]} has {length} rows")
            inside &= ~timeless
        else:
            inside = (table[:, 0] >= t[0] - 2.0) & (table[:, 0] <= t[-1] + 2.0)
        table = table[inside]
        if (np.diff(table[:, 0]) <= 0.0).any():
            raise ImportFailure(f"{path.name}: the time in {names[0]} does not increase in piece {number}")
        return table

    reference = rows("truth", ("truth",), (10,))
    log = rows("dvl", ("dvl_t", "dvl_v"), (0, 3))
    gnss = rows("gnss", ("gnss_t", "gnss_llh", "gnss_vned"), (0, 3, 3))
    return Piece(str(number), t, rate, force, reference, log[:, 0], log[:, 1:], gnss)
