"""Benchmarks of latency and stability, compared with peers and with physical limits."""
