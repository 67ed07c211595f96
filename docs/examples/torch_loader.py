"""Feed a dataset to torch: pictures and labels in batches, the failed samples left out.

    python docs/examples/torch_loader.py data/flat
    python docs/examples/torch_loader.py data/slide force_n slip_share

`twin.open_dataset` has ``__len__`` and ``__getitem__`` and keeps no file open, so it is a map-style dataset as it is,
and travels to the loader's workers. Only the named columns are read.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
import torch
from torch.utils.data import DataLoader

import twin


def loader(
    folder: str, labels: Sequence[str] = ("force_n",), split: str = "all", batch_size: int = 32, workers: int = 2
) -> DataLoader:
    """Return a loader of {"picture", "rest": (b, 3, h, w) in 0..1, and every label: (b, ...)}.

    ``rest`` is the picture of the same made sensor without load. Feed a network the difference: markers move by some
    pixels at most, and where they rest differs from sensor to sensor.

    ``split`` is "train", "test", or "all", as for `twin.open_dataset`.
    """
    data = twin.open_dataset(folder, ["picture", "sensor", *labels], split=split)

    def scaled(pictures: list[np.ndarray]) -> torch.Tensor:
        stacked = np.stack(pictures).transpose(0, 3, 1, 2)
        return torch.from_numpy(stacked).float() / np.iinfo(stacked.dtype).max

    def batch(samples: list[dict[str, np.ndarray]]) -> dict[str, torch.Tensor]:
        made = {name: torch.from_numpy(np.array([s[name] for s in samples])).float() for name in labels}
        rest = [data.sensor(s["sensor"])["picture"] for s in samples]
        return {"picture": scaled([s["picture"] for s in samples]), "rest": scaled(rest), **made}

    return DataLoader(data, batch_size=batch_size, shuffle=True, num_workers=workers, collate_fn=batch)


if __name__ == "__main__":
    for one in loader(sys.argv[1], sys.argv[2:] or ["force_n"]):
        print({name: tuple(values.shape) for name, values in one.items()})
