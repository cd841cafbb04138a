"""Common parts of the benchmarks: cases, sweeps, executors, results, timing figures."""
