"""Run time against error, by stage: ``python -m benchmarks [STAGE ...] [--quick]``."""
