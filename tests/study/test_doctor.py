"""What `twin doctor` says of libraries: found is what can be loaded."""

from __future__ import annotations

import ctypes.util
from pathlib import Path

import pytest

from twin.study import doctor


def test_libraries_that_are_listed_but_can_not_be_loaded_are_not_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    masked = tmp_path / "libGL.so.1"
    masked.write_bytes(b"")
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: str(masked))
    assert not doctor._loads("GL")
    assert "GL          not found" in "\n".join(doctor.examine().lines)
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    assert not doctor._loads("GL")
    monkeypatch.undo()
    assert doctor._loads("c")
