"""Run time against error, by stage: ``python -m benchmarks [STAGE ...] [--quick]``."""

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
"""The checkout, where pages, results and reference fields lie; ``twin`` may be installed elsewhere."""
