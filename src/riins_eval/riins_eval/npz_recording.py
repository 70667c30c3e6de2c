"""Foreign recordings in the common .npz layout: one clock or several IMUs, log, GNSS and reference, in pieces.

Lives here: `NpzRecording`, `Piece`, `load`, `ImportFailure`: reading and checking.
Does not live here: what becomes of a recording (importers.py), its motion between the epochs of the reference (reference.py).
"""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from riins_core.rotation import dcm_from_euler

Floats = NDArray[np.float64]

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
    """

    name: str
    t: Floats
    rate: Floats
    force: Floats
    reference: Floats
    log_t: Floats
    log_v: Floats
    gnss: Floats


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
    """

    path: Path
    rate_hz: int
    pieces: list[Piece]
    log_sigma: Floats | None
    log_lever: Floats | None
    gnss_sigma: Floats | None
    kind: str

    def reference_range_m(self) -> float:
        """Range of heights that the reference covers, m; 0 without a reference."""
        h = np.concatenate([p.reference[:, 3] for p in self.pieces])
        return float(np.ptp(h[np.isfinite(h)])) if np.isfinite(h).any() else 0.0


def load(path: str | Path) -> NpzRecording:
    """Read and check a recording.

    Parameters
    ----------
    path : .npz file in the common layout: `n_imu`; `imu_t`, `gyro_0`, `accel_0`; optional `imu_seg`, `truth`, `dvl_t`, `dvl_v`, `gnss_t`, `gnss_llh`,
        `gnss_vned` and their `*_seg`, `dvl_std`, `dvl_lever_frd`, `gnss_std`, `C_body_imu_0` or `euler_deg_0`, `imu_values` (mean or instantaneous)

    Returns
    -------
    NpzRecording

    Raises
    ------
    ImportFailure
        No such file, no npz, pickled content, several IMUs, a missing or malformed array, values that are not finite, time that does not increase.
    """
    path = Path(path)
    arrays = _read(path)
    count = int(_required(arrays, "n_imu", path, 0))
    if count != 1:
        raise ImportFailure(
            f"{path.name}: the recording has {count} IMUs, each with axes and a clock of its own: importing several IMUs is not possible yet"
        )
    t = _required(arrays, "imu_t", path, 1) if "imu_t" in arrays else _required(arrays, "imu_t_0", path, 1)
    gyro, accel = (_required(arrays, name, path, 2, (len(t), 3)) for name in ("gyro_0", "accel_0"))
    for name, array in (("imu_t", t), ("gyro_0", gyro), ("accel_0", accel)):
        _finite(name, array, path)
    if len(t) < 2:
        raise ImportFailure(f"{path.name}: imu_t has {len(t)} samples; at least two are needed")
    turn = _mounting(arrays, path)
    interval = float(np.median(np.diff(t)))
    if interval <= 0.0:
        raise ImportFailure(f"{path.name}: imu_t does not increase")
    rate_hz = round(1.0 / interval)
    if rate_hz < 1 or abs(rate_hz * interval - 1.0) > 0.001:
        raise ImportFailure(f"{path.name}: the IMU has an interval of {interval * 1e3:.3f} ms; a whole number of samples a second is needed")
    numbers = arrays.get("imu_seg")
    if numbers is None:
        numbers = np.concatenate([[0], np.cumsum(np.abs(np.diff(t)) > LONGEST_GAP_S)]) + 1
    elif numbers.shape != t.shape:
        raise ImportFailure(f"{path.name}: imu_seg has shape {numbers.shape}, imu_t {t.shape}")
    pieces = [_piece(arrays, path, int(n), numbers == n, t, gyro @ turn.T, accel @ turn.T) for n in _in_order(numbers)]
    kind = str(arrays["imu_values"]) if "imu_values" in arrays else ""
    if kind not in ("", "mean", "instantaneous"):
        raise ImportFailure(f'{path.name}: imu_values must be "mean" or "instantaneous", not "{kind}"')
    return NpzRecording(
        path,
        rate_hz,
        pieces,
        _vector(arrays, "dvl_std", 3, path),
        _vector(arrays, "dvl_lever_frd", 3, path),
        _vector(arrays, "gnss_std", 6, path),
        kind,
    )


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


def _mounting(arrays: Mapping[str, NDArray[np.generic]], path: Path) -> Floats:
    """C_body_imu of the one IMU."""
    if "C_body_imu_0" in arrays:
        turn = _array(arrays, "C_body_imu_0", path, 2, (3, 3))
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) or np.linalg.det(turn) < 0.0:
            raise ImportFailure(f"{path.name}: C_body_imu_0 is no rotation")
        return turn
    if "euler_deg_0" in arrays:
        return np.asarray(dcm_from_euler(*np.radians(_array(arrays, "euler_deg_0", path, 1, (3,)))))
    return np.eye(3)


def _in_order(numbers: NDArray[np.generic]) -> list[int]:
    _, first = np.unique(numbers, return_index=True)
    return [int(numbers[i]) for i in sorted(first)]


def _piece(
    arrays: Mapping[str, NDArray[np.generic]], path: Path, number: int, mine: NDArray[np.bool_], t: Floats, rate: Floats, force: Floats
) -> Piece:
    t, rate, force = t[mine], rate[mine], force[mine]
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
        if f"{stem}_seg" in arrays:
            inside = arrays[f"{stem}_seg"] == number
            if inside.shape != (length,):
                raise ImportFailure(f"{path.name}: {stem}_seg has shape {inside.shape}, {names[0]} has {length} rows")
        else:
            inside = (table[:, 0] >= t[0] - 2.0) & (table[:, 0] <= t[-1] + 2.0)
        table = table[inside]
        if not np.isfinite(table[:, 0]).all() or (np.diff(table[:, 0]) <= 0.0).any():
            raise ImportFailure(f"{path.name}: the time in {names[0]} does not increase in piece {number}")
        return table

    reference = rows("truth", ("truth",), (10,))
    log = rows("dvl", ("dvl_t", "dvl_v"), (0, 3))
    gnss = rows("gnss", ("gnss_t", "gnss_llh", "gnss_vned"), (0, 3, 3))
    return Piece(str(number), t, rate, force, reference, log[:, 0], log[:, 1:], gnss)
