"""Files of matrices by finite-element programs: what kind one is of, and which matrices it and its partners hold."""

from collections.abc import Callable
from pathlib import Path

from modalax.files.matrices import Matrix, read_abaqus, read_ansys, read_plain
from modalax.files.messages import about
from modalax.files.nastran import read_dmig


def kind_of(path: Path) -> str:
    """What a file holds: ``dmig``, ``modes`` (Nastran), ``abaqus``, ``market``, ``boeing`` or ``ansys``.

    Raises
    ------
    ValueError
        If it is none of them; the message says what to ask the program for.
    """
    if path.suffix.lower() in (".full", ".rst", ".emat"):
        return "ansys"
    with path.open("rb") as file:
        text = file.read(200_000).decode("latin-1")
    if text.startswith("%%MatrixMarket"):
        return "market"
    lines = [line for line in text.splitlines() if line.strip()]
    if any(line.startswith("$EIGENVECTOR") for line in lines[:20]):
        return "modes"
    if any(line.upper().startswith("DMIG") for line in lines):
        return "dmig"
    if any(line.upper().startswith(("GRID", "CEND", "BEGIN BULK", "SOL ")) for line in lines):
        raise ValueError(
            "a Nastran deck without matrices; let Nastran punch them (EXTSEOUT(STIF,MASS,DMIGPCH) or "
            "PARAM,EXTOUT,DMIGPCH), give the punch file, and this deck for its grid points (grids, --grids)"
        )
    if path.suffix.lower() in (".hb", ".rb", ".rsa", ".rua", ".hbmat", ".matrix"):
        return "boeing"
    first = next((line for line in lines if not line.startswith("*")), "")
    if len(first.replace(",", " ").split()) == 5:
        return "abaqus"
    raise ValueError(
        "not a file of matrices or modes that is known: Nastran punch (DMIG, eigenvectors), Abaqus .mtx, Ansys .full, "
        "Harwell-Boeing, Matrix Market"
    )


def matrices_of(
    path: Path, kind: str, mass: Path | None, damping: Path | None, names: tuple[str, str] | None
) -> tuple[Matrix, Matrix, Matrix | None, list[str]]:
    """Stiffness, mass and, if there is one, viscous damping of a file of a kind, and what was found of them.

    Raises
    ------
    ValueError
        If one is missing or cannot be read.
    """
    if kind == "dmig":
        return _punched(path, names)
    if kind == "ansys":
        K, M = read_ansys(path)
        return K, M, None, []
    notes = []
    if mass is None and kind == "abaqus":
        mass = _partner(path)
        if mass is not None:
            path, mass = (mass, path) if "MASS" in path.name.upper() else (path, mass)
            notes.append(f"stiffness from {path.name}, mass from {mass.name}")
    if mass is None:
        raise ValueError("one matrix alone; name the files of both, stiffness and mass (mass=..., --mass)")
    read: Callable[[Path], Matrix] = {
        "abaqus": read_abaqus,
        "market": read_plain,
        "boeing": lambda p: read_plain(p, harwell_boeing=True),
    }[kind]

    def other(path: Path) -> Matrix:
        with about(path):
            return read(path)

    return read(path), other(mass), None if damping is None else other(damping), notes


def _partner(path: Path) -> Path | None:
    """The mass beside a stiffness by Abaqus, or the other way round: ``JOB_STIF1.mtx`` and ``JOB_MASS1.mtx``."""
    for one, other in (("STIF", "MASS"), ("MASS", "STIF")):
        if one in path.name.upper():
            k = path.name.upper().rindex(one)
            for step in ("", "1", "2", "3"):
                tail = path.name[k + 4 :] if not step else f"{step}{path.suffix}"
                beside = path.with_name(path.name[:k] + other + tail)
                if beside.is_file():
                    return beside
    return None


def _punched(path: Path, names: tuple[str, str] | None) -> tuple[Matrix, Matrix, Matrix | None, list[str]]:
    """Stiffness, mass and viscous damping of a punch file, told by the first letter of their names: K, M, B."""
    found = read_dmig(path)
    if names is None:
        lists = [[name for name in found if name.startswith(letter) and name[1:2] != "4"] for letter in "KMB"]
        if len(lists[0]) != 1 or len(lists[1]) != 1 or len(lists[2]) > 1:
            raise ValueError(
                f"its matrices are {', '.join(found)}; one stiffness (K...) and one mass (M...) are needed, or name "
                "the two (matrices=, --matrices)"
            )
        stiffness, mass = lists[0][0], lists[1][0]
    else:
        stiffness, mass = names
        missing = [name for name in names if name not in found]
        if missing:
            raise ValueError(f"no matrix named {', '.join(missing)}; it holds {', '.join(found)}")
        lists = [[], [], []]
    C = found[lists[2][0]] if lists[2] else None
    return found[stiffness], found[mass], C, [f"stiffness is {stiffness}, mass is {mass}"]
