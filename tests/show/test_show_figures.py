"""Pictures: that they show what they should, with units on the axes, without pyplot."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

from modalax.identify import PoleTable
from modalax.model.examples import five_dof
from modalax.show import mode_names, plot_frf, plot_frf_grid, plot_levels, plot_mac, plot_modes, plot_residual_map
from modalax.show.frf import strongest, synthesised
from modalax.show.residuals import bin_lines
from modalax.show.stabilization import not_in_diagram, plot_stabilization, pole_kinds
from modalax.show.style import complex_plane, new_figure


@pytest.fixture(scope="module")
def structure():
    return five_dof()


@pytest.fixture(scope="module")
def measured(structure):
    frf = structure.frf(jnp.linspace(20, 70, 251), inputs=["1", "3"]).add_noise(jax.random.key(0), 0.1)
    size = jnp.abs(frf.H) ** 2
    return frf.replace(coherence=size / (size + frf.variance))


def labels(fig: Figure) -> str:
    fig.canvas.draw()
    texts = [t for ax in fig.axes for t in (ax.get_xlabel(), ax.get_ylabel(), ax.get_title())]
    return " | ".join([*texts, fig.get_supxlabel(), fig.get_supylabel(), fig.get_suptitle()])


def test_a_picture_shows_itself_in_a_window_of_pyplot(monkeypatch, measured):
    """While it is shown it is pyplot's figure; afterwards it is as before and pyplot keeps nothing."""
    import matplotlib.pyplot as plt

    fig, seen = plot_frf(measured), []
    plt.switch_backend("agg")
    monkeypatch.setattr(plt, "show", lambda: seen.append((plt.gcf(), fig.canvas.manager)))
    fig.show()
    assert [one for one, _ in seen] == [fig] and seen[0][1] is not None
    assert plt.get_fignums() == [] and fig.canvas.manager is None
    assert fig._repr_png_().startswith(b"\x89PNG")


def test_frf_shows_every_view_with_units(measured, structure):
    fig = plot_frf(measured, structure, output="2", input="1")
    text = labels(fig)
    for wanted in ("|H| [m/N]", "Phase [°]", "Coherence [-]", "Re H [m/N]", "Im H [m/N]", "Frequency [Hz]", "1 to 2"):
        assert wanted in text
    magnitude = fig.axes[0]
    lines = {line.get_label(): np.asarray(line.get_ydata()) for line in magnitude.lines}
    H = np.asarray(measured.pick(["2"], ["1"]).H)[:, 0, 0]
    exact = np.asarray(structure.frf(measured.freq, outputs=["2"], inputs=["1"]).H)[:, 0, 0]
    np.testing.assert_allclose(lines["measured"], np.abs(H))
    np.testing.assert_allclose(lines["fitted"], np.abs(exact))
    error = next(v for k, v in lines.items() if k.startswith("|measured - fitted|"))
    np.testing.assert_allclose(error, np.abs(H - exact))
    assert any(k.startswith("noise") for k in lines)


@pytest.mark.parametrize(("form", "unit"), [("mobility", "(m/s)/N"), ("accelerance", "(m/s²)/N")])
def test_unit_follows_the_form(measured, form, unit):
    text = labels(plot_frf(measured.to_form(form)))
    assert f"|H| [{unit}]" in text


def test_strongest_channel_is_drawn_by_default(measured):
    energy = np.sum(np.abs(np.asarray(measured.H)) ** 2, axis=0)
    o, i = np.unravel_index(energy.argmax(), energy.shape)
    assert strongest(measured) == (measured.outputs[o], measured.inputs[i])


def test_a_fit_on_other_lines_is_refused(measured, structure):
    other = structure.frf(jnp.linspace(20, 71, 251), inputs=["1", "3"])
    with pytest.raises(ValueError, match="same frequencies"):
        synthesised(measured, other)


def test_grid_draws_the_strongest_channels(measured, structure):
    fig = plot_frf_grid(measured, structure.modal(), most=4)
    assert sum(ax.get_visible() for ax in fig.axes) == 4
    assert "|H| [m/N]" in labels(fig)


def test_levels_are_named_by_force():
    H = np.ones((3, 11)) * (1 + 1j)
    fig = plot_levels(np.arange(11), H, [1.0, 2.5, np.nan])
    names = [t.get_text() for t in fig.axes[0].get_legend().get_texts()]
    assert names == ["1 N", "2.5 N", "run 3"]


@pytest.fixture(scope="module")
def table():
    poles = np.array([[-1 + 100j, -2 + 200j, 0], [-1 + 100j, -2 + 220j, 5 + 300j]])
    return PoleTable(jnp.asarray(poles), jnp.asarray([[True, True, False], [True] * 3]), None, (2, 4), "lscf")


def test_pole_kinds(table):
    """Shape stability counts only for a pole stable in damping, and damping only for one stable in frequency."""
    frequency = np.array([[True, True, True], [True, False, True]])
    damping = np.array([[True, False, True], [True, True, True]])
    shape = np.array([[False, True, True], [True, True, True]])
    kinds = pole_kinds(table, SimpleNamespace(frequency=frequency, damping=damping, shape=shape))
    np.testing.assert_array_equal(kinds, [[2, 1, -1], [3, 0, -1]])
    np.testing.assert_array_equal(pole_kinds(table, None), [[0, 0, -1], [0, 0, -1]])


def test_stabilization_marks_poles_where_they_are(table, measured):
    flags = SimpleNamespace(frequency=np.ones((2, 3), bool), damping=np.ones((2, 3), bool), shape=np.ones((2, 3), bool))
    fig = plot_stabilization(table, flags, measured, selected_hz=[31.8])
    text = labels(fig)
    assert "Model order" in text and "√CMIF [m/N]" in text
    points = np.concatenate([c.get_offsets() for c in fig.axes[0].collections])
    # 100 rad/s is 15.9 Hz, out of the band of the FRFs.
    np.testing.assert_allclose(sorted(points[:, 0]), np.sort(np.abs([-2 + 200j, -2 + 220j])) / (2 * np.pi))


def test_which_selected_modes_have_no_pole_in_the_diagram(table):
    """Poles lie at 100, 200 and 220 rad/s; one at 300 is unstable, none at 15 Hz."""
    wanted = np.array([100.0, 100.6, 199.5, 219.9, 300.0, 94.0]) / (2 * np.pi)
    np.testing.assert_array_equal(not_in_diagram(table, wanted), [False, True, False, False, True, True])
    assert not_in_diagram(table, []).shape == (0,)
    none = PoleTable(table.poles, jnp.zeros((2, 3), bool), None, (2, 4), "lscf")
    assert not_in_diagram(none, [10.0]).all()


def test_orders_are_whole_numbers_on_the_axis(table, measured):
    ax = plot_stabilization(table, None, measured).axes[0]
    assert all(float(t).is_integer() for t in ax.get_yticks())


def test_mac_holds_the_values(structure):
    values = np.array([[1.0, 0.25, 0.0], [0.1, 0.9, 0.04]])
    fig = plot_mac(values, rows=mode_names([10, 20]), row_title="Measured", column_title="Computed")
    ax = fig.axes[0]
    np.testing.assert_array_equal(ax.images[0].get_array(), values)
    assert [t.get_text() for t in ax.texts] == ["100", "25", "0", "10", "90", "4"]
    assert "Measured" in labels(fig) and "Computed" in labels(fig)


def test_modes_with_and_without_standard_deviations():
    fig = plot_modes([10, 20], [0.01, 0.02], frequency_std_hz=[0.1, np.nan], reference=([10, 20], [0.02, 0.02]))
    text = labels(fig)
    assert all(unit in text for unit in ("Natural frequency [Hz]", "Damping ratio [%]", "Damping deviation [%]"))
    deviation = fig.axes[2].lines[1].get_ydata()
    np.testing.assert_allclose(deviation, [-50, 0], atol=1e-12)
    assert plot_modes([10.0], [0.01]).axes[0].get_ylim()[1] > 1


def test_residual_map_of_noise_is_one():
    """Means over bins of |r|^2/2 with unit variance a real part are 1 within their own scatter."""
    rng = np.random.default_rng(3)
    r = rng.normal(size=(4, 5000)) + 1j * rng.normal(size=(4, 5000))
    mean, edges = bin_lines(np.arange(5000.0), np.abs(r) ** 2 / 2, 50)
    assert mean.shape == (4, 50) and edges.shape == (51,)
    # 100 samples a bin: standard deviation 0.1; five of them for 200 bins.
    assert np.abs(mean - 1).max() < 0.5
    assert edges[0] == -0.5 and edges[-1] == 4999.5
    fig = plot_residual_map(np.arange(5000.0), np.stack([r, 3 * r]), list("abcd"), panels=["before", "after"])
    assert "before" in labels(fig) and "noise alone" in labels(fig)


def test_residual_map_of_a_single_line():
    assert plot_residual_map([5.0], np.ones((2, 1)), ["a", "b"]).axes


def test_names_of_channels_are_drawn_letter_by_letter(structure):
    names = ["$\\alpha_1$", "a$b", "x_{2}^$", "4", "5"]
    frf = structure.frf(jnp.linspace(20, 70, 51), inputs=["1"]).replace(outputs=names, inputs=["$in$"])
    fig = plot_frf_grid(frf)
    drawn = labels(fig)
    assert r"\$\alpha_1\$ from \$in\$" in drawn  # what matplotlib shows as $\alpha_1$
    plot_frf(frf, output="$\\alpha_1$").canvas.draw()
    fig = plot_residual_map(frf.freq, np.ones((5, 51)), names)
    fig.canvas.draw()
    assert fig.axes[0].get_yticklabels()[0].get_text() == r"\$\alpha_1\$"


def test_numbers_of_a_nyquist_diagram_do_not_run_into_each_other():
    fig = new_figure(5.6, 5.2)
    ax = fig.subplots()
    ax.plot([-9e-5, 1e-4], [0.0, 2e-4])
    complex_plane(ax, "receptance")
    fig.draw_without_rendering()
    boxes = [t.get_window_extent() for t in ax.get_xticklabels() if t.get_text()]
    assert len(boxes) > 2
    assert all(a.x1 < b.x0 for a, b in zip(boxes, boxes[1:], strict=False))
    assert ax.get_xlabel() == "Re H [m/N]" and ax.get_ylabel() == "Im H [m/N]"
