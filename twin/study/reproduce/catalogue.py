"""The entries by name, in the papers' order."""

from __future__ import annotations

from collections.abc import Sequence

from twin.errors import InputError, did_you_mean
from twin.study.reproduce import (
    beyond,
    finger_calibration,
    finger_forces,
    finger_picture,
    finger_resolution,
    flat_forces,
    flat_picture,
    flat_shapes,
    reach,
    same_hardware,
    shifted,
    times,
)
from twin.study.reproduce.entry import Entry

ENTRIES: dict[str, Entry] = {
    entry.name: entry
    for entry in (
        shifted.KAMIYAMA_TABLE_1,
        flat_picture.FIGURE_6,
        shifted.KAMIYAMA_FIGURE_7,
        shifted.KAMIYAMA_FIGURE_8,
        flat_picture.FIGURE_9,
        flat_forces.FIGURE_10,
        flat_forces.FIGURE_11,
        flat_forces.FIGURE_12,
        flat_forces.FIGURE_13,
        flat_shapes.FIGURE_14,
        flat_shapes.FIGURE_15,
        flat_shapes.FIGURE_16,
        flat_picture.FIGURE_17,
        times.KAMIYAMA_TIMES,
        reach.KAMIYAMA_CONCLUSION,
        shifted.SATO_TABLE_1,
        finger_picture.FIGURE_6,
        finger_calibration.CALIBRATION,
        finger_picture.FIGURE_7,
        finger_forces.FIGURE_8,
        finger_resolution.FIGURE_9,
        times.SATO_TABLE_2,
        reach.SATO_PREDICTION,
        beyond.HALF_SPACE,
        beyond.LIMITS,
        *same_hardware.SAME_HARDWARE,
    )
}


def chosen(names: Sequence[str], quick: bool = False) -> list[Entry]:
    """Return the entries that ``names`` mean: ``all``, a paper, or entries by name; in the catalogue's order.

    The quick form leaves long ones out unless they are named.

    Raises
    ------
    InputError
        There is no such entry.
    """
    wanted: set[str] = set()
    for name in names or ("all",):
        found = [key for key in ENTRIES if name in ("all", key, key.split("/")[0])]
        if not found:
            hint = did_you_mean(name, (*(key.split("/")[0] for key in ENTRIES), *ENTRIES), "", 0.4)
            raise InputError(
                f"there is no entry '{name}':{hint and f' {hint}'} allowed are all, kamiyama, sato, beyond, "
                f"{', '.join(ENTRIES)}"
            )
        wanted.update(key for key in found if key == name or not (quick and ENTRIES[key].long))
    return [entry for key, entry in ENTRIES.items() if key in wanted]
