"""Exports of Nastran from the shell."""

from conftest import DATA


def test_convert_needs_no_option(hpcred, tmp_path):
    """From a shell: the file with its companions, and what info then says."""
    source = DATA / "nastran" / "test_1" / "test_case.pch1"
    run = hpcred("convert", source, "model.h5", ranks=2)
    assert run.returncode == 0, run.stderr
    run = hpcred("info", "model.h5")
    assert run.returncode == 0 and "1188" in run.stdout
    run = hpcred("convert", DATA / "nastran" / "test_1" / "test_case.bdf", "model.h5")
    assert run.returncode == 0, run.stderr
