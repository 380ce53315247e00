"""Numbers and tables as plain text."""

import pytest

from modalax._numerics.text import percent, text_table, with_error


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (26.0612, 0.0123, 1.0, "26.061 ± 0.012"),
        (0.02, 0.00041, 100.0, "2.000 ± 0.041"),
        (1234.5, 23.0, 1.0, "1234 ± 23"),
        (3.14159, None, 1.0, "3.1416"),
        (3.14159, float("nan"), 1.0, "3.1416"),
        (10.70869532, 3e-13, 1.0, "10.70869532 ± 3.0e-13"),
    ],
)
def test_a_value_is_written_to_the_place_of_its_error(value, std, unit, text):
    assert with_error(value, std, unit) == text


def test_columns_line_up():
    rows = [["1", "9.5", "x"], ["12", "10.25", ""]]
    assert text_table(["Mode", "Hz", "Flags"], rows, left=(2,)).splitlines() == [
        "Mode     Hz  Flags",
        "----  -----  -----",
        "   1    9.5  x",
        "  12  10.25",
    ]


@pytest.mark.parametrize(("share", "told"), [(0.0123, "1.2 %"), (0.0, "0 %"), (-0.99, "-99 %"), (1.64, "164 %")])
def test_a_share_in_per_cent_needs_no_power_of_ten(share, told):
    assert percent(share) == told
