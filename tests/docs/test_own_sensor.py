"""The page on an own sensor is followed: its commands run, on pictures of the recipe that it writes."""

import re
import shlex
from pathlib import Path

import pytest

import twin
from twin.cli import main
from twin.files import png_bytes

PAGE = (Path(__file__).parents[2] / "docs" / "own_sensor.md").read_text()
COMMANDS = [line for block in re.findall(r"^```sh\n(.*?)^```$", PAGE, re.M | re.S) for line in block.splitlines()]


def test_the_commands_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    told = []
    for command in COMMANDS:
        if "rest1.png" in command and not Path("rest1.png").exists():
            sensor = twin.Sensor(twin.load_scene("mine.toml"))
            Path("rest1.png").write_bytes(png_bytes(sensor.picture(None)))
        if "rest2.png" in command:
            continue  # `tests/study/test_camera_check.py`: it solves the body for the error of forces
        with pytest.raises(SystemExit) as done:
            main(shlex.split(command)[1:])
        assert not done.value.code, command
        told.append(capsys.readouterr().out)
    assert ": ok" in told[1]
    assert "without source" not in told[1]
    assert "165 dark dots, 15 columns x 11 rows, square" in told[2]
    assert {"markers.toml", "markers.png"} <= {path.name for path in tmp_path.iterdir()}
