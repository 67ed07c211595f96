"""Train a small network that reads the total force from pictures, and test it on other made sensors.

twin dataset dataset_kamiyama --samples 400 --columns force_n,picture -s dataset.samples_per_sensor=20 --out data/net
python docs/examples/train_network.py data/net 20
"""

from __future__ import annotations

import sys

import torch
from torch_loader import loader

torch.manual_seed(0)
network = torch.nn.Sequential(
    torch.nn.Conv2d(3, 16, 5, 2),
    torch.nn.ReLU(),
    torch.nn.Conv2d(16, 32, 5, 2),
    torch.nn.ReLU(),
    torch.nn.Conv2d(32, 32, 3, 2),
    torch.nn.ReLU(),
    torch.nn.Flatten(),
    torch.nn.LazyLinear(64),
    torch.nn.ReLU(),
    torch.nn.Linear(64, 3),
)


def pooled(folder: str, split: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Return what changed in the pictures of a split, a quarter as wide and high, and the forces, N."""
    rows = [(10 * (one["picture"] - one["rest"]), one["force_n"]) for one in loader(folder, ["force_n"], split)]
    return torch.cat([torch.nn.functional.avg_pool2d(x, 4) for x, _ in rows]), torch.cat([y for _, y in rows])


def rms(errors: torch.Tensor) -> float:
    """Return the root mean square of the lengths of (n, 3) errors."""
    return errors.pow(2).sum(1).mean().sqrt().item()


if __name__ == "__main__":
    folder, rounds = sys.argv[1], int(sys.argv[2])
    (pictures, forces), (others, truth) = pooled(folder, "train"), pooled(folder, "test")
    network(others[:1])  # the lazy layer learns its size
    optimiser = torch.optim.Adam(network.parameters(), 1e-3)
    for number in range(rounds):
        for some in torch.randperm(len(pictures)).split(16):
            error = network(pictures[some]) - forces[some]
            optimiser.zero_grad()
            error.pow(2).mean().backward()
            optimiser.step()
        with torch.no_grad():
            print(f"round {number + 1}: {rms(network(others) - truth):.3f} N off on other sensors (rms)", flush=True)
    print(f"always saying the mean force: {rms(truth - forces.mean(0)):.3f} N")
