"""Finite-element files against closed forms, against matrices written here, and against Nastran's own eigenvalues."""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse

import modalax
from modalax import Structure
from modalax.cli import main
from modalax.files.finite_elements import import_finite_elements
from modalax.files.nastran import number, read_grids
from modalax.files.nastran_groups import read_groups
from modalax.model.condense import condense, follow, lowest_modes

STEEL = 2.0e4  # spring of the chain [N/m]


def chain(n: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Free chain of unit masses: eigenvalues 4 k sin^2(r pi / 2 n)."""
    K = STEEL * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[0, 0] = K[-1, -1] = STEEL
    return np.eye(n), K


def exact(n: int = 6) -> np.ndarray:
    return np.sqrt(4 * STEEL) * np.sin(np.arange(n) * np.pi / (2 * n)) / (2 * np.pi)


def dmig(name: str, A: np.ndarray, component: int = 3, wide: bool = True) -> str:
    """A symmetric matrix as Nastran punches it: one triangle, ten digits (or small fields)."""
    lines = [f"DMIG    {name:<8}       0       6       2       0        {len(A):>16}"]
    for c in range(len(A)):
        rows = [r for r in range(c + 1) if A[r, c] != 0]
        if wide:
            lines.append(f"DMIG*   {name:<16}{c + 1:>16}{component:>16}")
            lines += [f"*       {r + 1:>16}{component:>16}{A[r, c]:16.9E}".replace("E", "D") for r in rows]
        else:
            first, *rest = [f"{r + 1:>8}{component:>8}{A[r, c]:>8.6g}{'':8}" for r in rows]
            lines.append(f"DMIG    {name:<8}{c + 1:>8}{component:>8}{'':8}{first}")
            lines += [f"{'':8}{entry}" for entry in rest]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("wide", [True, False])
def test_a_punched_chain_has_the_frequencies_of_the_closed_form(tmp_path, wide):
    M, K = chain()
    path = tmp_path / "chain.pch"
    path.write_text(dmig("KAAX", K, wide=wide) + dmig("MAAX", M, wide=wide))
    with pytest.warns(UserWarning, match="chain.pch"):
        structure = modalax.load(path)
    assert isinstance(structure, Structure)
    assert structure.dofs[:2] == ("1:+Z", "2:+Z") and ("1:+Z", "2:+Z") in (structure.pairs or ())
    np.testing.assert_allclose(structure.modal().frequency_hz, exact()[1:], rtol=1e-9 if wide else 1e-4)


def test_units_in_inches_and_pounds_become_si(tmp_path):
    M, K = chain()
    path = tmp_path / "chain.pch"
    path.write_text(dmig("KAAX", K) + dmig("MAAX", M))
    found = import_finite_elements(path, units="in-lbf", damping_ratio=0.01)
    pound_per_inch = 4.4482216152605 / 0.0254
    assert found.mass["Z"] == pytest.approx(6 * pound_per_inch, rel=1e-12)  # 1 lbf s^2 / in is 175.1 kg
    np.testing.assert_allclose(found.simulation.K, K * pound_per_inch, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(found.simulation.modal().damping_ratio, 0.01, rtol=1e-9)
    with pytest.raises(ValueError, match="units are 'furlong'; known are m-N"):
        import_finite_elements(path, units="furlong")


def test_massless_points_follow_exactly_and_stiff_light_ones_nearly():
    """A beam of two lengths: the massless middle is a spring in series; a light stiff DoF hardly changes the lowest."""
    K = np.array([[3e4, -2e4, 0.0], [-2e4, 5e4, -3e4], [0.0, -3e4, 3e4]])
    M = np.diag([1.0, 0.0, 2.0])
    small = condense(M, K, up_to_hz=30.0)
    assert small.kept.tolist() == [True, False, True]
    series = 1 / (1 / 2e4 + 1 / 3e4)
    np.testing.assert_allclose(small.K, [[1e4 + series, -series], [-series, series]], rtol=1e-12)
    light = condense(np.diag([1.0, 1e-6, 2.0]), K, up_to_hz=30.0)
    assert light.kept.sum() == 2 and light.change < 1e-3
    assert condense(np.diag([1.0, 1e-6, 2.0]), K, up_to_hz=30.0, keep=[1]).kept.all()


def test_rounding_gives_rigid_bodies_stiffness_and_it_is_taken_away():
    """Eigenvalues of a chain of springs written with six digits: spread by rounding as predicted, rigid ones 0."""
    rng = np.random.default_rng(0)
    M, K = chain(8)
    K *= 1e4
    stretch = np.diag(1 + 0.3 * rng.random(8))
    rounded = np.vectorize(lambda x: float(f"{x:.5e}"))(stretch @ K @ stretch)
    mass = stretch @ M @ stretch
    small = condense(mass, rounded, digits=6)
    assert small.rigid == 1 and 0 < small.rigid_eigenvalue < 5 * small.rounding
    assert abs(lowest_modes(small.M, small.K)[0][0]) < 1e-6 * small.rigid_eigenvalue
    true = lowest_modes(mass, stretch @ K @ stretch)[0]
    error = (small.eigenvalue - true[: len(small.eigenvalue)])[1:] / small.deviation[1:]
    assert np.abs(error).max() < 4


def test_a_direction_without_mass_or_stiffness_is_said():
    M, K = chain(4)
    with pytest.raises(ValueError, match="neither mass nor stiffness"):
        condense(np.pad(M, (0, 1)), np.pad(K, (0, 1)))
    with pytest.raises(ValueError, match="the stiffness matrix is not symmetric"):
        condense(M, K + np.eye(4, k=1) * 100)


def test_local_displacement_axes_turn_to_basic_ones(tmp_path):
    """A mass on three springs, its displacements given in a system that is turned about z by 30 degrees."""
    stiff = np.diag([1e4, 4e4, 9e4])
    angle = np.deg2rad(30.0)
    turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    local = turn @ stiff @ turn.T
    text = ["DMIG    KAAX           0       6       2       0                       3"]
    for c in range(3):
        text.append(f"DMIG*   {'KAAX':<16}{1:>16}{c + 1:>16}")
        text += [f"*       {1:>16}{r + 1:>16}{local[r, c]:16.9E}" for r in range(c + 1)]
    text.append("DMIG    MAAX           0       6       2       0                       3")
    for c in range(3):
        text += [f"DMIG*   {'MAAX':<16}{1:>16}{c + 1:>16}", f"*       {1:>16}{c + 1:>16}{2.0:16.9E}"]
    (tmp_path / "k.pch").write_text("\n".join(text) + "\n")
    x, y = np.cos(angle), np.sin(angle)
    (tmp_path / "deck.bdf").write_text(
        f"CORD2R,5,,0.,0.,0.,0.,0.,1.\n,{x:.6f},{y:.6f},0.\nGRID,1,,1.0,2.0,3.0,5\nENDDATA\n"
    )
    found = import_finite_elements(tmp_path / "k.pch", grids=tmp_path / "deck.bdf")
    np.testing.assert_allclose(found.simulation.K, stiff, rtol=1e-5, atol=0.05)
    assert any("it is supported" in sentence for sentence in found.notes)
    np.testing.assert_allclose(found.geometry.xyz, [[1, 2, 3]])


def test_cylindrical_and_spherical_points(tmp_path):
    deck = tmp_path / "deck.bdf"
    deck.write_text(
        "CORD2C,1,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\nCORD2S,2,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n"
        "GRID,7,1,2.0,90.,3.0,1\nGRID,8,2,2.0,90.,90.,2\n"
    )
    grids = read_grids(deck)
    np.testing.assert_allclose(grids[7].xyz, [0, 2, 3], atol=1e-12)
    np.testing.assert_allclose(grids[7].axes, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(grids[8].xyz, [0, 2, 0], atol=1e-12)
    np.testing.assert_allclose(grids[8].axes, [[0, 1, 0], [0, 0, -1], [-1, 0, 0]], atol=1e-12)


@pytest.mark.parametrize(("text", "value"), [("7.+10", 7e10), ("1.5D-3", 1.5e-3), ("-2.5-4", -2.5e-4), ("12", 12.0)])
def test_nastran_numbers(text, value):
    assert number(text) == value


def test_abaqus_matrices_find_each_other(tmp_path):
    M, K = chain(4)
    for name, A in (("STIF", K), ("MASS", M)):
        lines = [f"{i + 1},3, {j + 1},3, {A[i, j]:.12e}" for i in range(4) for j in range(i + 1) if A[i, j]]
        lines += ["9,1, 9,1, 1.000000000000e+36"] if name == "STIF" else []
        (tmp_path / f"job_{name}1.mtx").write_text("\n".join(lines) + "\n")
    with pytest.warns(UserWarning, match="job_MASS1.mtx"):
        structure = modalax.load(tmp_path / "job_MASS1.mtx")
    np.testing.assert_allclose(structure.modal().frequency_hz, exact(4)[1:], rtol=1e-9)


@pytest.mark.parametrize("kind", ["market", "boeing"])
def test_plain_matrices_with_the_mass_named(tmp_path, kind):
    M, K = chain(4)
    for name, A in (("K", K), ("M", M)):
        if kind == "market":
            scipy.io.mmwrite(str(tmp_path / name), scipy.sparse.coo_matrix(A), symmetry="symmetric")
        else:
            scipy.io.hb_write(str(tmp_path / f"{name}.hb"), scipy.sparse.csc_matrix(A))
    ending = {"market": "mtx", "boeing": "hb"}[kind]
    with pytest.raises(ValueError, match="one matrix alone; name the files of both"):
        modalax.load(tmp_path / f"K.{ending}")
    found = import_finite_elements(tmp_path / f"K.{ending}", mass=tmp_path / f"M.{ending}")
    assert found.simulation.dofs == ("1", "2", "3", "4")
    np.testing.assert_allclose(found.simulation.modal().frequency_hz, exact(4)[1:], rtol=1e-9)


def test_large_models_are_reduced_to_the_dofs_that_are_named(tmp_path):
    n = 3001
    K = scipy.sparse.diags([2.0, -1.0, -1.0], [0, 1, -1], shape=(n, n)) * 1e9
    for name, A in (("K", K), ("M", scipy.sparse.eye(n))):
        scipy.io.mmwrite(str(tmp_path / name), A.tocoo(), symmetry="symmetric")
    files = tmp_path / "K.mtx", {"mass": tmp_path / "M.mtx"}
    with pytest.raises(ValueError, match="3001 DoFs, too many to keep as matrices; name those"):
        import_finite_elements(files[0], **files[1])
    found = import_finite_elements(files[0], keep=["1500", "40"], damping_ratio=0.01, up_to_hz=30.0, **files[1])
    model = found.simulation
    assert {"40", "1500"} < set(model.dofs) and len(model.dofs) < 60 and model.pairs is None
    assert "DoFs follow the others; frequencies change by" in found.notes[-1]
    modalax.save(model, tmp_path / "small.npz")
    assert modalax.load(tmp_path / "small.npz").dofs == model.dofs
    model = model.modal()
    np.testing.assert_allclose(model.damping_ratio, 0.01, rtol=1e-6)
    r = np.arange(1, 6)
    wanted = np.sqrt(4e9) * np.sin(r * np.pi / (2 * (n + 1))) / (2 * np.pi)
    np.testing.assert_allclose(model.frequency_hz[:5], wanted, rtol=1e-4)


def test_a_deck_without_matrices_says_what_to_ask_nastran_for(tmp_path):
    (tmp_path / "wing.bdf").write_text("SOL 103\nCEND\nBEGIN BULK\nGRID,1,,0.,0.,0.\nENDDATA\n")
    with pytest.raises(ValueError, match="wing.bdf: a Nastran deck without matrices; let Nastran punch them"):
        modalax.load(tmp_path / "wing.bdf")


def test_the_command_writes_a_simulation_and_tells_what_it_found(tmp_path, capfd):
    M, K = chain()
    (tmp_path / "chain.pch").write_text(dmig("KAAX", K) + dmig("MAAX", M))
    out = tmp_path / "sim.npz"
    assert main(["import-fe", str(tmp_path / "chain.pch"), "-o", str(out), "--damping", "0.02", "--keep", "*:+Z"]) == 0
    told = capfd.readouterr().err
    assert "1 rigid-body modes" in told and "total mass 6 kg along Z" in told
    np.testing.assert_allclose(modalax.load(out).modal().damping_ratio, 0.02, rtol=1e-9)
    assert main(["import-fe", str(tmp_path / "chain.pch"), "-o", str(out)]) == 2
    assert main(["import-fe", str(tmp_path / "none.pch"), "-o", str(tmp_path / "x.npz")]) == 2
    assert main(["import-fe", str(tmp_path / "chain.pch"), "-o", str(tmp_path / "y.npz"), "--keep", "9:+X"]) == 2
    assert "no DoF named '9:+X'; they are called like 1:+Z" in capfd.readouterr().err


def printed_eigenvalues(path: Path) -> np.ndarray:
    """The first table of real eigenvalues of an ``.f06`` file."""
    text = path.read_text(encoding="latin-1").split("R E A L   E I G E N V A L U E S")[1]
    rows = re.findall(r"^ +\d+ +\d+ +([-0-9.E+]+)(?: +[-0-9.E+]+){4}$", text, re.MULTILINE)
    return np.array([float(row) for row in rows])


@pytest.mark.measured
@pytest.mark.parametrize(("name", "deck"), [("test_1/test_case", "bdf"), ("test_2/sol103_swept_plane", "bdf")])
def test_nastrans_eigenvalues_to_their_printed_digits(measured, name, deck):
    folder = measured / "nastran"
    printed = printed_eigenvalues(folder / f"{name}.f06")
    found = import_finite_elements(folder / f"{name}.pch1", grids=folder / f"{name}.{deck}")
    assert any("cost no force" in sentence for sentence in found.notes)
    K, M = (np.asarray(getattr(import_full(folder / f"{name}.pch1"), k)) for k in ("K", "M"))
    value = lowest_modes(M, K)[0][: len(printed)]
    elastic = printed > 0
    last_digit = 10.0 ** (np.floor(np.log10(printed[elastic])) - 6)
    assert (np.abs(value[elastic] - printed[elastic]) < 1.01 * last_digit).all()
    ours = (2 * np.pi * np.asarray(found.simulation.modal().frequency_hz)) ** 2
    count = min(8, int(elastic.sum()) // 2)
    np.testing.assert_allclose(
        ours[:count], printed[elastic][:count], rtol=3e-4
    )  # what condensation may change, squared


def import_full(path: Path) -> Structure:
    """The matrices as they stand in the file."""
    from modalax.files.nastran import read_dmig

    found = read_dmig(path)
    dofs = found["KAAX"].dofs
    K, M = (found[k].on(dofs).toarray() for k in ("KAAX", "MAAX"))
    return Structure(M, np.zeros_like(K), K, [f"{p}:{c}" for p, c in dofs])


@pytest.mark.measured
def test_a_flying_wing_within_the_digits_of_its_punch_file(measured):
    """Ten digits of stiffness leave the lowest frequencies uncertain: predicted, and the differences are no larger."""
    folder = measured / "nastran" / "mAEWing1_v5p2"
    printed = printed_eigenvalues(folder / "sol103_maewing1_femv5p2.f06")
    found = import_finite_elements(
        folder / "stiffness_mass.pch", grids=folder / "sol103_mAEWing1_FEMv5p2.bdf", units="in-lbf", damping_ratio=0.01
    )
    assert found.mass["Z"] == pytest.approx(13.80127 * 0.45359237 * 0.002591 * 386.0886, rel=1e-4)  # with WTMASS
    full = import_full(folder / "stiffness_mass.pch")
    small = condense(np.asarray(full.M), np.asarray(full.K), digits=10)
    elastic = printed[printed > 0][: len(small.eigenvalue) - small.rigid]
    deviation = np.hypot(small.deviation[small.rigid :], 5e-7 * elastic)[: len(elastic)]
    apart = np.abs(small.eigenvalue[small.rigid :][: len(elastic)] - elastic) / deviation
    assert small.rigid == 6 and apart.max() < 4 and np.median(apart) < 1.5
    modes = import_finite_elements(folder / "sol103_maewing1_femv5p2.pch1", units="in-lbf", damping_ratio=0.01)
    np.testing.assert_allclose((2 * np.pi * modes.simulation.frequency_hz) ** 2, printed[6:20], rtol=1e-6)


@pytest.mark.measured
def test_a_flying_wing_parts_into_its_elements(measured):
    """Put together from its elements the wing has the printed eigenvalues, closely, and no rigid stiffness."""
    folder = measured / "nastran" / "mAEWing1_v5p2"
    printed = printed_eigenvalues(folder / "sol103_maewing1_femv5p2.f06")
    found = import_finite_elements(
        folder / "stiffness_mass.pch", grids=folder / "sol103_mAEWing1_FEMv5p2.bdf", units="in-lbf", damping_ratio=0.01
    )
    structure = found.simulation
    assert isinstance(structure, Structure) and structure.elements is not None
    assert len(structure.elements.places) == 74 and len(structure.elements.mass) == 71
    every = structure.elements.dofs
    assert len(every) == 426 and set(structure.dofs) < set(every)
    factors = structure.elements.stiffness, structure.elements.mass
    K, M = (np.einsum("enr,emr->nm", F, F, optimize=True) for F in map(np.asarray, factors))
    T = follow(K, np.isin(every, structure.dofs))
    for whole, full in ((structure.K, K), (structure.M, M)):
        assert np.abs(T.T @ full @ T - whole).max() < 1e-6 * np.abs(whole).max()
    square = scipy.linalg.eigh(np.asarray(structure.K), np.asarray(structure.M), eigvals_only=True)
    assert np.abs(square[:6]).max() < 1e-3
    np.testing.assert_allclose(square[6:20], printed[6:20], rtol=5e-5)


def test_elements_of_one_property_and_one_material_make_groups(tmp_path):
    """A chain of rods in a row along z: two properties of one material, the third of another, and one of two rods."""
    n, rods = 7, {(1, 2): 10, (2, 3): 10, (3, 4): 11, (4, 5): 11, (5, 6): 12, (6, 7): 12}
    stiffness = {10: 2e4, 11: 3e4, 12: 5e4}
    K = np.zeros((n, n))
    for (a, b), p in rods.items():
        K[np.ix_([a - 1, b - 1], [a - 1, b - 1])] += stiffness[p] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    path, deck = tmp_path / "rods.pch", tmp_path / "rods.bdf"
    path.write_text(dmig("KAAX", K) + dmig("MAAX", np.eye(n)))
    grids = [f"GRID,{k + 1},,0.,0.,{k}." for k in range(n)]
    bars = [f"CROD,{k + 1},{p},{a},{b}" for k, ((a, b), p) in enumerate(rods.items())]
    bars += ["CBUSH,90,40,6,7"]  # beside a rod: their sum alone is known, and it is but one element
    more = ["PROD,10,1,1.", "PROD,11,1,1.", "PROD,12,2,1.", "PBUSH,40,K,1.", "MAT1,1,1.,,.3", "MAT1,2,1.,,.3"]
    deck.write_text("\n".join(["BEGIN BULK", *grids, *bars, *more, "ENDDATA"]) + "\n")
    assert list(read_groups(deck)) == ["PROD 10", "PROD 11", "PROD 12", "PROD 12 + PBUSH 40", "MAT1 1", "MAT1 2"]
    found = import_finite_elements(path, grids=deck, damping_ratio=0.01, groups=True)
    groups = found.simulation.groups
    assert groups.names == ("PROD 10", "PROD 11", "MAT1 1") and "PROD 11, MAT1 1" in found.notes[-1]
    diagonal = 1e4 * np.array([[2, 4, 2, 0, 0, 0, 0], [0, 0, 3, 6, 3, 0, 0], [2, 4, 5, 6, 3, 0, 0]])
    assert np.abs(np.diagonal(groups.stiffness, axis1=1, axis2=2) - diagonal).max() < 1e-3
    assert not np.asarray(groups.mass).any()
    assert import_finite_elements(path, grids=deck).simulation.groups is None
    with pytest.raises(ValueError, match="groups of elements are read from a Nastran deck"):
        import_finite_elements(path, groups=True)
