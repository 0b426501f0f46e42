"""Prints what pytest-benchmark's own table does not: time per step and per residual."""

from __future__ import annotations

from itertools import groupby


def pytest_terminal_summary(terminalreporter, config):
    session = getattr(config, "_benchmarksession", None)
    if session is None or not session.benchmarks:
        return
    write = terminalreporter.write_line
    done = [bench for bench in session.benchmarks if bench.extra_info.get("steps")]
    for problem, benches in groupby(sorted(done, key=lambda b: b.group), key=lambda b: b.group):
        rows = list(benches)
        base = rows[0].stats.median / rows[0].extra_info["steps"]
        write(f"\n{problem}: median of {rows[0].stats.rounds} runs")
        write(f"{'integrator':48} {'steps':>7} {'us/step':>9} {'us/residual':>12} {'ratio':>7}")
        for bench in rows:
            info, seconds = bench.extra_info, bench.stats.median
            write(
                f"{info['integrator']:48} {info['steps']:7d} {1e6 * seconds / info['steps']:9.2f} "
                f"{1e6 * seconds / info['residuals']:12.2f} "
                f"{seconds / info['steps'] / base:7.2f}"
            )
