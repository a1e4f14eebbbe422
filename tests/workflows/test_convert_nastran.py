"""Exports of Nastran from the shell."""

from conftest import DATA

from hpcred.cli.main import run


def test_convert_needs_no_option(hpcred, tmp_path, capsys):
    """From a shell: the file with its companions, and what info then says."""
    source = DATA / "nastran" / "test_1" / "test_case.pch1"
    done = hpcred("convert", source, "model.h5", ranks=2)
    assert done.returncode == 0, done.stderr
    assert run(["info", str(tmp_path / "model.h5")]) == 0 and "1188" in capsys.readouterr().out
    assert run(["convert", str(source.with_suffix(".bdf")), str(tmp_path / "other.h5")]) == 0
