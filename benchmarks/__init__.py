"""Speed of every stage beside a peer that is timed in the same run: ``python -m benchmarks.stages``."""
