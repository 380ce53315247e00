"""Time records read back from files of every kind as they were written by others' programs."""

import contextlib
import warnings

import h5py
import numpy as np
import pytest
import pyuff
import scipy.io

from modalax.check.record_files import read_records
from modalax.data.recording import channels_of
from modalax.files import load_records

FS, COUNT = 1024.0, 200
TIME = np.arange(COUNT) / FS
RNG = np.random.default_rng(4)
FORCE, ACC = RNG.normal(size=COUNT), RNG.normal(size=(2, COUNT))


def told(path, **options):
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        return load_records(path, **options), [str(w.message) for w in heard]


def same(found, names, units, values=(FORCE, *ACC)):
    assert found.fs == FS and found.channels == tuple(names) and found.units == tuple(units)
    assert np.allclose(found.data[0].T, np.array(values), rtol=1e-6, atol=1e-9)


def table(path, separator, decimals=".", headings=()):
    rows = [
        separator.join(f"{v:.9g}".replace(".", decimals) for v in row) for row in zip(TIME, FORCE, *ACC, strict=True)
    ]
    path.write_text("\n".join([*headings, *rows]) + "\n", encoding="latin-1")
    return path


@pytest.mark.parametrize(
    ("separator", "decimals", "headings"),
    [
        (",", ".", ["Time [s],Force [N],a1 [m/s²],a2 [m/s²]"]),
        (";", ",", ["Messung 12; Halle 3", "Zeit;Force;a1;a2", "s;N;m/s²;m/s²"]),
        ("\t", ".", ["time (s)\tForce (N)\ta1 (m/s²)\ta2 (m/s²)"]),
        (" ", ".", ["% made by a logger"]),
    ],
)
def test_tables_of_text(tmp_path, separator, decimals, headings):
    found, notes = told(table(tmp_path / "a.csv", separator, decimals, headings))
    if separator == " ":
        same(found, ["channel 2", "channel 3", "channel 4"], ["", "", ""])
        assert any("taken as time" in n for n in notes)
    else:
        same(found, ["Force", "a1", "a2"], ["N", "m/s²", "m/s²"])
    assert found.numbers == (2, 3, 4) and found.index("3") == 1


def test_arrays_with_and_without_time(tmp_path):
    np.save(tmp_path / "t.npy", np.array([TIME, FORCE, *ACC]))
    same(told(tmp_path / "t.npy")[0], ["channel 2", "channel 3", "channel 4"], ["", "", ""])
    np.save(tmp_path / "n.npy", np.array([FORCE, *ACC]).T)
    with pytest.raises(ValueError, match=r"n\.npy: holds no sampling rate \(200 samples of 3 channels\)"):
        load_records(tmp_path / "n.npy")
    same(told(tmp_path / "n.npy", fs=FS)[0], ["channel 1", "channel 2", "channel 3"], ["", "", ""])
    several, notes = told([tmp_path / "t.npy"] * 3)
    assert several.data.shape == (3, COUNT, 3) and len(notes) == 1
    np.save(tmp_path / "s.npy", np.stack([[FORCE, ACC[0]], [FORCE, ACC[1]]]))
    assert told(tmp_path / "s.npy", fs=FS)[0].data.shape == (2, COUNT, 2)


def test_named_arrays(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"Force": FORCE, "Acceleration": ACC, "Fs": FS})
    found, notes = told(tmp_path / "a.mat")
    same(found, ["Force", "Acceleration 1", "Acceleration 2"], ["", "", ""])
    assert any("sampling rate 1024 Hz from its Fs" in n for n in notes)
    scipy.io.savemat(tmp_path / "b.mat", {"rec": {"f": FORCE, "a": ACC.T, "fs": FS}})
    same(told(tmp_path / "b.mat")[0], ["rec.f", "rec.a 1", "rec.a 2"], ["", "", ""])
    np.savez(tmp_path / "c.npz", f=FORCE, a=ACC, dt=1 / FS)
    same(told(tmp_path / "c.npz")[0], ["f", "a 1", "a 2"], ["", "", ""])
    np.savez(tmp_path / "d.npz", x=np.array([FORCE, *ACC]), freq=np.arange(50.0))
    with pytest.raises(ValueError, match=r"say which one to read .*x \(3, 200\)"):
        load_records(tmp_path / "d.npz", fs=FS)
    same(told(tmp_path / "d.npz", fs=FS, array="x")[0], ["x 1", "x 2", "x 3"], ["", "", ""])
    with pytest.raises(ValueError, match="holds no array 'y'"):
        load_records(tmp_path / "d.npz", fs=FS, array="y")
    with h5py.File(tmp_path / "e.h5", "w") as file:
        for name, unit, value in (("hammer", "N", FORCE), ("a1", "g", ACC[0]), ("a2", "g", ACC[1])):
            file[name] = value
            file[name].attrs["unit"] = unit
        file.attrs["sample_rate"] = FS
    found, _ = told(tmp_path / "e.h5")
    order = [found.channels.index(n) for n in ("hammer", "a1", "a2")]
    assert [found.units[k] for k in order] == ["N", "g", "g"] and found.fs == FS
    assert np.array_equal(found.data[0, :, order], np.array([FORCE, *ACC]))


@pytest.mark.parametrize("axes", [(0, 1, 2), (0, 2, 1)])
def test_named_arrays_of_several_records(tmp_path, axes):
    force, a = RNG.normal(size=(5, COUNT)), RNG.normal(size=(5, COUNT, 2))
    np.savez(tmp_path / "a.npz", force=force, response=a.transpose(axes), fs=FS)
    found, notes = told(tmp_path / "a.npz")
    assert found.channels == ("force", "response 1", "response 2") and "5 records of 200 samples each" in notes[-1]
    assert np.array_equal(found.data[:, :, 0], force) and np.array_equal(found.data[:, :, 1:], a)
    checked = read_records(tmp_path / "a.npz")
    assert np.array_equal(checked.force, force) and np.array_equal(checked.response, a) and checked.fs == FS
    for wrong in (force[:4], force[0], force[:, :100], force[None, None]):
        np.savez(tmp_path / "b.npz", force=wrong, response=a, fs=FS)
        with pytest.raises(ValueError, match="its arrays do not go together; say which one to read"):
            load_records(tmp_path / "b.npz")


def test_sound_files(tmp_path):
    whole = np.round(np.clip(np.array([FORCE, *ACC]) / 8, -1, 1) * 32767).astype(np.int16)
    scipy.io.wavfile.write(tmp_path / "a.wav", int(FS), whole.T)
    found, notes = told(tmp_path / "a.wav")
    same(found, ["channel 1", "channel 2", "channel 3"], ["", "", ""], whole / 32768)
    assert any("full scale" in n for n in notes)
    scipy.io.wavfile.write(tmp_path / "b.wav", int(FS), np.array([FORCE, *ACC]).T.astype(np.float32))
    same(told(tmp_path / "b.wav")[0], ["channel 1", "channel 2", "channel 3"], ["", "", ""])


def uff_set(node, direction, kind, unit, values):
    return {
        "type": 58, "binary": 1, "func_type": 1, "data": values, "x": TIME, "rsp_node": node, "rsp_dir": direction,
        "ref_node": 0, "ref_dir": 0, "id1": f"ch {node}", "abscissa_spacing": 1, "abscissa_inc": 1 / FS,
        "abscissa_spec_data_type": 17, "ordinate_spec_data_type": kind, "ordinate_axis_units_lab": unit,
        "orddenom_spec_data_type": 0,
    }  # fmt: skip


def write_uff(path, sets):
    with contextlib.redirect_stdout(None), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pyuff.UFF(str(path)).write_sets(sets, mode="add")
    return path


def test_universal_files(tmp_path):
    once = [uff_set(5, 3, 13, "N", FORCE), uff_set(1, 3, 12, "g", ACC[0]), uff_set(2, -3, 12, "g", ACC[1])]
    same(told(write_uff(tmp_path / "a.uff", once))[0], ["5:+Z", "1:+Z", "2:-Z"], ["N", "g", "g"])
    twice, _ = told(write_uff(tmp_path / "b.uff", once * 2))
    assert twice.data.shape == (2, COUNT, 3) and np.allclose(twice.data[0], twice.data[1])
    with pytest.raises(ValueError, match="stand unequally often"):
        load_records(write_uff(tmp_path / "c.uff", [*once, once[0]]))


@pytest.mark.parametrize("titles", [("NONE", "NONE"), ("Force", "Acc")])
@pytest.mark.parametrize("labels", [("N", "g"), ("NONE", "NONE")])
def test_force_and_response_of_a_drive_point_have_one_name(tmp_path, titles, labels):
    once = [
        {**uff_set(node, 3, kind, label, values), "id1": title}
        for node, kind, label, title, values in [
            (17, 12, labels[1], titles[1], ACC[0]), (1, 12, labels[1], titles[1], ACC[1]),
            (17, 13, labels[0], titles[0], FORCE),
        ]
    ]  # fmt: skip
    found, _ = told(write_uff(tmp_path / "a.uff", once * 2))
    assert found.channels == ("17:+Z", "1:+Z", "17:+Z") and found.data.shape == (2, COUNT, 3)
    assert found.units == ({"g": "g"}.get(labels[1], "m/s^2"),) * 2 + ("N",)
    chosen = channels_of(found, ["17:+Z"], ["17:+Z"])
    assert np.array_equal(chosen.force[0, :, 0], FORCE) and chosen.inputs == chosen.outputs == ["17:+Z"]
    with pytest.raises(ValueError, match=r"2 channels are named 17:\+Z: choose by number; there are 1 17:\+Z"):
        found.index("17:+Z")


def test_time_of_a_universal_file_in_the_unit_of_its_label(tmp_path):
    in_unit = lambda label, size: [
        {**s, "abscissa_axis_units_lab": label, "abscissa_inc": size / FS, "x": size * TIME}
        for s in (uff_set(5, 3, 13, "N", FORCE), uff_set(1, 3, 12, "g", ACC[0]))
    ]
    found, notes = told(write_uff(tmp_path / "a.uff", in_unit("ms", 1e3)))
    assert found.fs == FS and not notes
    found, notes = told(write_uff(tmp_path / "b.uff", in_unit("ticks", 1.0)))
    assert found.fs == FS and "its time axis is in ticks, which is not known: taken as s" in notes[0]


def test_motions_of_two_quantities_at_one_place_are_channels(tmp_path):
    sets = [uff_set(1, 3, 13, "N", FORCE), uff_set(2, 3, 12, "g", ACC[0]), uff_set(2, 3, 11, "m/s", ACC[1])]
    same(told(write_uff(tmp_path / "a.uff", sets))[0], ["1:+Z", "2:+Z", "2:+Z"], ["N", "g", "m/s"])


def test_what_cannot_be_read_is_said(tmp_path):
    (tmp_path / "empty.csv").write_text("\n")
    with pytest.raises(ValueError, match="the file is empty"):
        load_records(tmp_path / "empty.csv")
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_records(tmp_path / "absent.csv")
    (tmp_path / "prose.txt").write_text("once upon a time\n")
    with pytest.raises(ValueError, match="no line of numbers"):
        load_records(tmp_path / "prose.txt")
    (tmp_path / "broken.csv").write_text("1,2\n3,4\n5,x\n")
    with pytest.raises(ValueError, match="line 3 .*'5,x'; 2 numbers"):
        load_records(tmp_path / "broken.csv", fs=1.0)
    (tmp_path / "a.bin").write_bytes(b"abc\x00def")
    with pytest.raises(ValueError, match="neither of UFF 58"):
        load_records(tmp_path / "a.bin")
    (tmp_path / "cut.wav").write_bytes(b"RIFF\x10\x00")
    with pytest.raises(ValueError, match="damaged"):
        load_records(tmp_path / "cut.wav")
    with pytest.raises(ValueError, match="no file of time records"):
        load_records([])
