"""A sequence through one tracker grows by nothing."""

from benchmarks.frames import follow


def test_memory_threads_and_files_stay_flat():
    states = follow(1500)
    early, late = states[len(states) // 5], states[-1]
    assert late["memory_mb"] - early["memory_mb"] < 4.0
    assert (late["threads"], late["files"]) == (early["threads"], early["files"])
