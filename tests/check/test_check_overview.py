from modalax.check import Finding, Findings


def test_a_check_prints_what_the_command_line_says():
    hum = Finding("hum", ("a", "b"), "a line at 50 Hz", "ground the sensors", 0.93, size=0.2, unit="N")
    assert str(Findings((hum,), about=("8 FRFs were looked at.",))).splitlines() == [
        "8 FRFs were looked at.",
        "What  Where   Size  Sure",
        "----  -----  -----  ----",
        "hum   a, b   0.2 N  0.93",
        "hum (a, b): a line at 50 Hz.",
        "  to do: ground the sensors.",
    ]
    assert str(hum).splitlines() == [
        "hum (a, b): a line at 50 Hz.", "  to do: ground the sensors.", "  0.2 N, sure: 0.93",
    ]  # fmt: skip


def test_a_sound_measurement_prints_that_nothing_was_found():
    assert str(Findings(())) == "nothing wrong was found"
