"""Feed a dataset to torch: pictures and forces in batches, the failed samples left out.

    python docs/examples/torch_loader.py data/flat

`twin.open_dataset` has ``__len__`` and ``__getitem__`` and keeps no file open, so it is a map-style dataset as it is,
and travels to the loader's workers. Only the named columns are read.
"""

from __future__ import annotations

import sys

import numpy as np
import torch
from torch.utils.data import DataLoader, Subset

import twin


def loader(folder: str, batch_size: int = 32, workers: int = 2) -> DataLoader:
    """Return a loader of {"picture": (b, 3, h, w) in 0..1, "force_n": (b, 3)}."""
    status = twin.open_dataset(folder, ["status"])
    good = [row for row in range(len(status)) if status[row]["status"] == "ok"]
    data = Subset(twin.open_dataset(folder, ["picture", "force_n"]), good)

    def batch(samples: list[dict[str, np.ndarray]]) -> dict[str, torch.Tensor]:
        pictures = np.stack([s["picture"] for s in samples]).transpose(0, 3, 1, 2)
        forces = np.stack([s["force_n"] for s in samples])
        return {"picture": torch.from_numpy(pictures).float() / 255, "force_n": torch.from_numpy(forces).float()}

    return DataLoader(data, batch_size=batch_size, shuffle=True, num_workers=workers, collate_fn=batch)


if __name__ == "__main__":
    for one in loader(sys.argv[1]):
        print(one["picture"].shape, one["force_n"].shape)
