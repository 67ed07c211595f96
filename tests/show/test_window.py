"""The window of a deformed body: refused with a remedy where none can be, and drawn as what it shows where one can."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from twin.errors import MissingCapability
from twin.show import body_view
from twin.show.body_view import BodyView


def view_of(slip: list[bool]) -> BodyView:
    """Return a tetrahedron with two markers, one square in contact on each of some."""
    count = len(slip)
    square = np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0.3, 0], [0, 0.3, 0]])
    frame = BodyView.Frame(
        name="1",
        said="Step 1.",
        displacement_mm=np.zeros((4, 3)),
        marker_displacement_mm=np.full((2, 3), 0.01),
        patch_mm=square + np.array([[0.4 * k - 0.5, 0.0, 0.0] for k in range(count)]).reshape(-1, 1, 3),
        patch_displacement_mm=np.zeros((count, 3)),
        traction_mpa=np.tile([0.0, 0.0, 1.0], (count, 1)),
        slip=np.array(slip, bool),
    )
    return BodyView(
        title="a corner",
        corner_mm=np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0], [0, 0, 1.5]], float),
        triangle=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]),
        marker_mm=np.array([[-0.2, 0, 0.3], [0.2, 0, 0.6]]),
        marker_layer=np.array(["blue", "red"]),
        layer_radius_mm={"blue": 0.1, "red": 0.1},
        frames=(frame,),
    )


def test_without_a_display_or_opengl_the_page_is_named_instead(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(MissingCapability, match=r"DISPLAY is not set.*without --window a page is written"):
        body_view.BodyView.require_window()
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr(body_view, "TRIAL", "import os; os.abort()")
    with pytest.raises(MissingCapability, match="OpenGL, which does not draw here"):
        body_view.BodyView.require_window()
    monkeypatch.setattr(body_view, "TRIAL", "")
    body_view.BodyView.require_window()


@pytest.mark.slow
def test_it_draws_markers_and_what_sticks_and_slips(tmp_path: Path) -> None:
    if subprocess.run(
        [sys.executable, "-c", body_view.TRIAL], capture_output=True, timeout=body_view.TRIAL_S
    ).returncode:
        pytest.skip("OpenGL does not draw here")
    code = (
        "import sys\nfrom pathlib import Path\nfrom test_window import view_of\n"
        "view_of([False, True]).show(Path(sys.argv[1])); view_of([]).show(Path(sys.argv[2]))"
    )
    pictures = [tmp_path / "touched.png", tmp_path / "untouched.png"]
    subprocess.run([sys.executable, "-c", code, *map(str, pictures)], check=True, cwd=Path(__file__).parent)
    from PIL import Image

    counts = []
    for picture in pictures:
        seen = np.asarray(Image.open(picture).convert("RGB")).astype(int)
        red, green, blue = seen.transpose(2, 0, 1)
        counts.append(
            [int(chosen.sum()) for chosen in ((red - blue > 60) & (green > 80), blue - red > 60, (red - green > 40))]
        )
    (slips, blues, _), (none, markers, reds) = counts
    assert slips > 500 > none
    assert blues > markers + 500
    assert min(markers, reds) > 50
