"""Published measurements: found in a local folder, checked by their hash, and read into the objects of this package."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from modalax.data.frf import FRF
from modalax.data.geometry import Geometry
from modalax.data.measurement import Measurement
from modalax.data.roving import copied_hits, hit_signs, reciprocal_places

FOLDER = "MODALAX_DATA"
STANDARD_GRAVITY = 9.80665  # m/s^2, by definition

ORIGIN = {
    "uliege_plane": "github.com/VictorRenkin/MECA0062-1_vibration_testing at commit a22f882, its FRFs, coherences, "
    "spectra and last time blocks gathered in frf.npz, its finite-element shapes in fe_modes.npz",
    "brake_reuss_beam": "github.com/mattiacenedese/BRBtesting at commit 2d42d3a (GPL-3), the force-controlled stepped "
    "sine near 80 Hz gathered in force_control.npz",
    "steel_beam": "github.com/alxhslm/ModeLAB at commit 4a27c98 (GPL-3), its beam test gathered in frf.npz",
    "hammer_hits": "github.com/ladisk/pyFRF, its history (MIT), files measurements_1.npy to measurements_5.npy",
    "silverbox": "nonlinearbenchmark.org, Silverbox (Wigren and Schoukens 2013), file SNLS80mV.mat",
    "f16": "github.com/emckenzie11/F16_Benchmark_Analysis at commit 033c962, a copy of the F-16 benchmark of Noël and "
    "Schoukens (4TU 2017), the files F16Data_FullMSine_Level1.mat, 3, 5 and 7",
    "nastran": "github.com/zhaowei0566/mAEWing2 at commit 83a9625 (MIT), its ground vibration test in mAEWing2_gvt",
}  # fmt: skip
HASHES = {
    "uliege_plane/frf.npz": "9eaaafa2b6f5089fb0503ea6ddf3f3253e6655d07cb168b95302ec88d416c295",
    "uliege_plane/fe_modes.npz": "8c34a8f57a18d7cda619ae613e0718ef00f645627463e4d7b6e1702a4011c51b",
    "uliege_plane/node_shock.csv": "ac4609ebd1f94ffd9ba5e89cfbde39f3118f210f5d773e68a0b7b6645c7eeab9",
    "uliege_plane/node_structure.csv": "846c9afe49d9000d76f0cc19c76beccb7fdfa49d5788543466b92e0b4ec4a105",
    "brake_reuss_beam/force_control.npz": "8da427804d16d42ffa2028a9687edb5512af694f0f6a8fd391f57dd6aac8c4e8",
    "steel_beam/frf.npz": "fbe723302f937b0137af9a779a878dbb02e56283c7109ad2b17c7942ee26e09a",
    "hammer_hits/measurements_1.npy": "7111c3ea3c2e88bdb35008acf36e5ff38567a457a8789e6d245ea43d787f6334",
    "hammer_hits/measurements_2.npy": "330524c0b134fe972663d7e88788d1850b45f9336cb1079a9e0ddafdff3d9c18",
    "hammer_hits/measurements_3.npy": "f20168bada006c5d788f62a82586233da9a5ff75c6db897c5d66fe7950d370f5",
    "hammer_hits/measurements_4.npy": "7a0213bf9feaa5fb22f196536de5a6bce3960dbf74df9759a979977851e78e1c",
    "hammer_hits/measurements_5.npy": "240026cdc9fb024ed2b1a914038ef55afd6c54c50a03e6b5051de4d5e39de097",
    "silverbox/SNLS80mV.mat": "5c7413a52255af0cb4e2f93fb6903beb92b08965ba1e6ad0a6ffedfed8477ed4",
    "f16/F16Data_FullMSine_Level1.mat": "30e7bec7115a117f1391466c1dce34d05c673054fd1a862c441bd4d45dc19b2b",
    "f16/F16Data_FullMSine_Level3.mat": "f06fcb7cc0486b50352c1d3a7045617ab24cad8fbe0f282c27baba1c3d139839",
    "f16/F16Data_FullMSine_Level5.mat": "e92c8a6ad21d5d8af62741baa8dc6b667aa7332d0d8d79115849ba4ff42949b0",
    "f16/F16Data_FullMSine_Level7.mat": "bd6dedf8bf1aec4dbba40fb2b553592408dbd0043e11c87a6d8c6969086f46a0",
    "nastran/mAEWing2_gvt/Modes_GVT_huggin_v3.mat": "a567ca50357354185c8fca95598ca6119e70b819ef6a9357633dd2f3454f53db",
    "nastran/mAEWing2_gvt/mAEWing2_Full_GVT_accelero_v2.dat": (
        "a775b57b46beb948b869b3744f8f52020d0e2daa7ec6f2b876cba1e08b9c91d6"
    ),
    "nastran/mAEWing2_gvt/sol103_maewing2_fullmodel_gvt_setup_check_updatedgrid_initial_4MAC.pch": (
        "8e5cc98dcc83512ddd9d3377d8516181fedcb16f49198a75877c95236e1e8176"
    ),
}


def data_file(name: str, folder: Path | None = None) -> Path:
    """Path of a data file, for example ``steel_beam/frf.npz``, after its hash was checked.

    It is looked for in ``folder`` alone if one is given, else in the folder that the environment variable
    ``MODALAX_DATA`` names, then in pooch's cache folder for modalax. Nothing is downloaded: the originals carry
    licences of their own, or none.

    Raises
    ------
    FileNotFoundError
        If the file is not there; the message says where to get it and where to put it.
    ValueError
        If it is another version of the file.
    """
    named, origin = os.environ.get(FOLDER), ORIGIN[name.split("/")[0]]
    path = (folder or (Path(named) if named else _cache())) / name
    if not path.is_file():
        cached = path if folder else _cache() / name
        also = "" if cached == path else f" (or to {cached})"
        if not cached.is_file():
            raise FileNotFoundError(
                f"{path}: no such file; get it from {origin}; put it there{also}, or set {FOLDER} to the folder that "
                f"holds {name}"
            )
        path = cached
    found = _sha256(path)
    if found != HASHES[name]:
        raise ValueError(f"{path}: sha256 is {found}, known is {HASHES[name]}; get that version from {origin}")
    return path


def _cache() -> Path:
    try:
        import pooch
    except ImportError as error:
        raise ImportError(
            f"set {FOLDER} to the folder of the example measurements, or install their cache: "
            "pip install 'modalax[data]'"
        ) from error
    return Path(pooch.os_cache("modalax"))


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def known_measurement(path: Path) -> FRF | Measurement | None:
    """The FRFs of a data set known here, names, signs and units included, if ``path`` is its file; else None.

    It is the file if it has the name, the folder's name and the hash.
    """
    known = _known(path)
    return known if known is None or isinstance(known, FRF | Measurement) else known.frf


def known_geometry(path: Path) -> Geometry | None:
    """Where the DoFs of a data set known here are, if ``path`` is its file (:func:`known_measurement`); else None."""
    return getattr(_known(path), "geometry", None)


def _known(path: Path) -> "UliegePlane | SteelBeam | FRF | Measurement | None":
    path = path.absolute()
    name = f"{path.parent.name}/{path.name}"
    if name not in SETS or _sha256(path) != HASHES[name]:
        return None
    return SETS[name](path.parents[1])


class UliegePlane(eqx.Module):
    """Hammer test of a laboratory aeroplane (University of Liège), 3 accelerometers, 74 hit points.

    Attributes
    ----------
    frf
        Accelerance [(m/s^2)/N], shape ``(1601, 3, hits)``, every DoF in the positive direction of its axis; with
        coherence, and with a variance if the number of averages was given.
    geometry
        Hit points ``1`` to ``74`` (row ``k`` of ``node_shock.csv`` is node ``k + 1``), nodes of the outline that were
        not hit ``75`` to ``84``, and accelerometers ``101`` to ``103``, with the outline as lines.
    hits
        The directions in which the hits really went, for example ``2:-Z``, in the order of ``frf.inputs``.
    fe_shapes
        Shapes of the finite-element model along ``frf.inputs``, shape ``(13, hits)`` [-].
    fe_displacements
        The same in all directions at all hit points, shape ``(13, 74, 3)`` [-].
    time, blocks
        The last time block of every hit as recorded, shapes ``(4096,)`` [s] and ``(hits, 4, 4096)``: force [N], then
        the accelerometers [m/s^2]. Signs are not changed here.
    copied
        Hit points whose record is a copy of another point's to the last digit, and so says nothing about them.
    sensor_mismatch
        Mismatch of reciprocity between accelerometers at the hit points found for them, shape ``(3, 3)`` [-].
    outside_fe
        Fraction of the FRFs' energy from 10 to 110 Hz outside the span of the first six finite-element shapes [-].
    sign_agreement
        Correlation of each hit with what those shapes make of all other hits, shape ``(74,)`` [-].
    """

    frf: FRF
    geometry: Geometry
    hits: tuple[str, ...] = eqx.field(static=True)
    fe_shapes: Float[np.ndarray, "n i"]
    fe_displacements: Float[np.ndarray, "n point 3"]
    time: Float[np.ndarray, " t"]
    blocks: Float[np.ndarray, "i 4 t"]
    copied: tuple[str, ...] = eqx.field(static=True)
    sensor_mismatch: Float[np.ndarray, "3 3"]
    outside_fe: float
    sign_agreement: Float[np.ndarray, " point"]


# Records that belong to the points of node_shock.csv, in its order; the others were repeated or discarded hits.
RECORDS = (*range(1, 29), *range(31, 59), *range(61, 79))
ALONG_Z = 68  # the points before this one were hit along z, those from it on (the fin) along x
SIGN_BAND, SIGN_SHAPES = (10.0, 110.0), 6  # band [Hz] and finite-element shapes from which the signs are found
SENSOR_NODES = ("101", "102", "103")


def uliege_plane(
    averages: int | None = None, at_hits: bool = False, copies: bool = False, folder: Path | None = None
) -> UliegePlane:
    r"""Laboratory aeroplane, roving hammer; signs of the hits and places of the accelerometers from the data.

    *Signs.* The files do not tell whether a point was hit from one side or the other. The force channel does not
    either: its peak is positive in every record, as a hammer reads any push. Between 10 and 110 Hz the response is
    that of the first six modes, whose shapes the finite-element model gives; :func:`modalax.data.roving.hit_signs`
    finds the signs with which the FRFs fit into their span. Result: point 1 and the six points of the fin (69-74) have
    the opposite sign of all others; 1.7 % of the energy then lies outside the span (8.9 % without the fin's signs),
    and every hit correlates with its prediction by 0.76 or more.

    *Accelerometers.* :func:`modalax.data.roving.reciprocal_places` finds the hit points at which they obey
    reciprocity: on the right wing near its tip (point 3), on the right tip of the tailplane (58) and on top of the fin
    (70), each counting against the hits. The FRFs that should be equal still differ by 10 % between wing and tailplane
    or fin and by 36 % between the latter two (root mean square, every line weighing the same): the accelerometers
    sit near these points, not on them. Together: with accelerometers along +Z, +Z and +X, the hits went along -Z on
    wing and tailplane, +X on the fin, and +Z at point 1, which was hit from below. One sign common to all
    axes stays open; it has no effect on any FRF.

    *Copies.* The record of point 17 is that of point 16 to the last digit; it is left out unless ``copies``.

    *Noise.* With ``n`` averages, :math:`\mathrm{var} H = |H|^2(1-\gamma^2)/(n\gamma^2)`. The number was not recorded,
    so there is no variance unless one is given; and what lacks in coherence is here mostly smooth in frequency
    (hits beside the point, records too short for the lightest damped modes), so that it overstates random noise.

    Parameters
    ----------
    averages
        Number of averages to take the variance from.
    at_hits
        Name the accelerometers after the hit points nearest to them, so that modal masses can be worked out, roughly
        (see above); otherwise they are nodes 101 to 103.
    copies
        Keep hits whose record is a copy.
    folder
        Where the data set's folder is (:func:`data_file`).

    Raises
    ------
    FileNotFoundError, ValueError
        If the files are not there, or other ones (:func:`data_file`).
    """
    raw, fe = (np.load(data_file(f"uliege_plane/{name}.npz", folder)) for name in ("frf", "fe_modes"))
    points, outline = (
        np.loadtxt(data_file(f"uliege_plane/{name}.csv", folder), delimiter=",", skiprows=1) / 1000
        for name in ("node_shock", "node_structure")
    )
    records, count = list(RECORDS), len(points)
    axis = np.where(np.arange(count) < ALONG_Z, 2, 0)
    freq, shapes = raw["freq"], fe["shape"][:, np.arange(count), axis]
    H = raw["H"][records].transpose(2, 1, 0)
    coherence = raw["coh"][records].transpose(2, 1, 0)
    band = (freq >= SIGN_BAND[0]) & (freq <= SIGN_BAND[1])
    signs, outside, agreement = hit_signs(H[band], shapes[:SIGN_SHAPES])
    near, sensor_signs, mismatch = reciprocal_places(H[band] * signs)
    # The first accelerometer defines the positive direction.
    directions, sensor_signs = signs * sensor_signs[0], sensor_signs * sensor_signs[0]
    H = H * STANDARD_GRAVITY * directions * sensor_signs[:, None]
    variance = None if averages is None else np.abs(H) ** 2 * (1 - coherence) / (averages * coherence)
    names = [f"{k + 1}:+{'XYZ'[a]}" for k, a in enumerate(axis)]
    sensors = [names[p] if at_hits else f"{n}:+{'XYZ'[axis[p]]}" for n, p in zip(SENSOR_NODES, near, strict=True)]
    blocks = raw["x"][records].astype(float) * np.array([1.0, *[STANDARD_GRAVITY] * 3])[:, None]
    second = {later for _, later in copied_hits(raw["x"][records])}
    keep = [k for k in range(count) if copies or k not in second]
    frf = FRF(
        freq, H, form="accelerance", variance=variance, coherence=coherence, averages=averages,
        outputs=sensors, inputs=names,
    )  # fmt: skip
    went = [f"{k + 1}:{'-' if directions[k] < 0 else '+'}{'XYZ'[axis[k]]}" for k in keep]
    return UliegePlane(
        frf=frf.pick(inputs=[names[k] for k in keep]), geometry=_plane_geometry(points, outline, near),
        hits=tuple(went), fe_shapes=shapes[:, keep], fe_displacements=fe["shape"], time=raw["t"],
        blocks=blocks[keep], copied=tuple(str(k + 1) for k in sorted(second)), sensor_mismatch=mismatch,
        outside_fe=outside, sign_agreement=agreement,
    )  # fmt: skip


def _plane_geometry(points: np.ndarray, outline: np.ndarray, near: tuple[int, ...]) -> Geometry:
    """Nodes, and for wing, tailplane and fin their two edges and the ribs between them as lines."""
    extra = [p for p in outline if not (np.abs(points - p).max(axis=1) < 1e-9).any()]
    plane = np.array([*points, *extra])
    names = [str(k + 1) for k in range(len(plane))]
    x, y, z = plane.T
    lines: list[list[str]] = []
    for surface, span in ((z == 0, x), (z == z[ALONG_Z - 1], x), (x == 0, z)):
        sides = [np.flatnonzero(surface & (y == end)) for end in (y[surface].min(), y[surface].max())]
        edges = [[names[k] for k in side[np.argsort(span[side])]] for side in sides]
        lines += [*edges, *map(list, zip(*edges, strict=True))]
    return Geometry([*names, *SENSOR_NODES], np.array([*plane, *points[list(near)]]), lines)


def brake_reuss_beam(drive_point: bool = False, folder: Path | None = None) -> Measurement:
    """Free beam with a bolted lap joint, stepped sine through its first bending mode at four controlled force levels.

    One output, one input, 41 lines from 79.2 to 81.2 Hz, accelerance of the fundamental [(m/s^2)/N]; ``level`` is the
    mean force amplitude over the lines [N], which the controller let vary by about a third, ``force`` that of
    each line. The phase falls from 0 to -180 degrees: the accelerometer counts against the force.

    Parameters
    ----------
    drive_point
        Turn the sign of the accelerometer and give force and response one name, ``beam``. As long as one mode stands
        for the band, a response elsewhere is that of the drive point times a constant, so that only the scale of the
        modal mass, and with it of forces and displacements in a joint, stays open.
    folder
        Where the data set's folder is (:func:`data_file`).

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is not there, or another one (:func:`data_file`).
    """
    raw = np.load(data_file("brake_reuss_beam/force_control.npz", folder))
    H = raw["acceleration_m_s2"] / raw["force_n"] * np.exp(1j * raw["phase_rad"])
    return Measurement(
        raw["frequency_hz"][0], (-H if drive_point else H)[:, :, None, None], form="accelerance", force=raw["force_n"],
        outputs=["beam" if drive_point else "response"], inputs=["beam" if drive_point else "force"],
    )  # fmt: skip


class SteelBeam(eqx.Module):
    """Beam with a roving hammer at nine points and one accelerometer.

    Attributes
    ----------
    frf
        Accelerance [(m/s^2)/N], shape ``(51201, 1, 9)``; the accelerometer sits at hit point 4, a drive point.
    geometry
        Points ``1`` to ``9`` along z [m].
    """

    frf: FRF
    geometry: Geometry


def steel_beam(folder: Path | None = None) -> SteelBeam:
    """Steel beam, nine hits, one accelerometer at the fourth, 0 to 1000 Hz.

    The accelerometer points along -X against the hits, as its drive-point FRF shows, whose imaginary part is negative
    at every resonance; here the sign is turned, so that every DoF is along +X. Values are stored in single precision.

    Parameters
    ----------
    folder
        Where the data set's folder is (:func:`data_file`).

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is not there, or another one (:func:`data_file`).
    """
    raw = np.load(data_file("steel_beam/frf.npz", folder))
    z = raw["z_hammer_m"]
    names = [str(k + 1) for k in range(len(z))]
    sensor = names[int(np.argmin(np.abs(z - raw["z_accel_m"])))]
    H = -raw["H"].astype(complex).T[:, None]
    frf = FRF(raw["freq"], H, form="accelerance", outputs=[f"{sensor}:+X"], inputs=[f"{n}:+X" for n in names])
    return SteelBeam(frf, Geometry(names, np.stack([0 * z, 0 * z, z], axis=1), [names]))


# Files of FRFs, and how they are read from the folder that holds the data sets' folders.
SETS: "dict[str, Callable[[Path], UliegePlane | SteelBeam | FRF | Measurement]]" = {
    "uliege_plane/frf.npz": lambda folder: uliege_plane(folder=folder),
    "brake_reuss_beam/force_control.npz": lambda folder: brake_reuss_beam(folder=folder),
    "steel_beam/frf.npz": lambda folder: steel_beam(folder),
}


class Records(eqx.Module):
    """Time records of one input and one output.

    Attributes
    ----------
    time
        Shape ``(t,)`` [s].
    input, output
        Shape ``(record, t)``.
    sample_rate
        [Hz]
    """

    time: Float[np.ndarray, " t"]
    input: Float[np.ndarray, "record t"]
    output: Float[np.ndarray, "record t"]
    sample_rate: float


def hammer_hits() -> Records:
    """Five hammer hits on one structure: force and response, units unknown, 25 600 samples at 25 600 Hz each.

    Raises
    ------
    FileNotFoundError, ValueError
        If a file is not there, or another one (:func:`data_file`).
    """
    hits = np.array([np.load(data_file(f"hammer_hits/measurements_{k}.npy")) for k in range(1, 6)])
    return Records(hits[0, 0], hits[:, 1], hits[:, 2], 25600.0)


def silverbox() -> Records:
    """Electronic Duffing oscillator: one record of 131 072 samples of input and output voltage.

    Samples up to 40 500 are noise of growing amplitude, then come ten odd random-phase multisines.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is not there, or another one (:func:`data_file`).
    """
    from scipy.io import loadmat

    raw: dict[str, Any] = loadmat(data_file("silverbox/SNLS80mV.mat"))
    rate = 1e7 / 2**14
    return Records(np.arange(raw["V1"].size) / rate, raw["V1"].astype(float), raw["V2"].astype(float), rate)
