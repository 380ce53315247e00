from modalax.cli import main


def test_cache_is_shown_and_cleared(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    for k in range(3):
        (tmp_path / f"jit_f-{k}-cache").write_bytes(b"x" * 500_000)
        (tmp_path / f"jit_f-{k}-atime").write_bytes(b"12345678")
    (tmp_path / "notes.txt").write_text("not a program")
    assert main(["cache"]) == 0
    assert capsys.readouterr().out.strip() == f"{tmp_path}: 3 compiled programs, 1.5 MB"
    assert main(["cache", "--clear"]) == 0
    assert "removed 3 compiled programs" in capsys.readouterr().out
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
    assert main(["cache"]) == 0
    assert "0 compiled programs, 0.0 MB" in capsys.readouterr().out


def test_a_cache_that_is_not_there_is_empty(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "none"))
    assert main(["cache"]) == 0
    assert "0 compiled programs" in capsys.readouterr().out
