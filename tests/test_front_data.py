"""The data of the pages without a browser: the numbers of the store."""

from __future__ import annotations

import re

import pytest
from planted import page_data, planted

from bench.results.store import Store
from reports.pages.site_data import _value


def test_the_policy_allows_no_script_but_the_page_s_own(site):
    text = (site / "report.html").read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text).group(1)
    (scripts,) = [part for part in policy.split("; ") if part.startswith("script-src")]
    assert scripts.replace("&#39;", "'") == "script-src 'self'"
    assert "default-src 'none'" in policy.replace("&#39;", "'")
    assert len(text) < 300_000


def test_a_column_keeps_its_numbers_and_those_that_are_missing():
    for cost, shown in [
        *((None, None), (0.0, 1e-40), (1e-50, 1e-40), (1e300, 1e40), (12345.678, 12346.0)),
        *((1e-5, 1e-5), (x := 1e-5 * (1 + 1e-9), x)),  # an accuracy, and beside it
    ]:
        run = planted("p", "i", {}, h=0.1, work={"residuals": cost}, operations={})
        assert _value(run, "residuals") == shown


def test_the_data_hold_the_numbers_of_the_store_and_every_answer(site):
    data = page_data(site)
    assert len(data["answers"]) == len(data["group_names"]) * 4 * 3
    with Store(site) as store:
        records = list(store.records().values())
    found = {}
    for scene, own in zip(data["scenes"], data["runs_of"], strict=True):
        for runs in own:
            label = data["methods"][runs["method"]]["label"]
            for k, at in enumerate(runs["resolutions"]):
                found[scene["id"], label, at] = [c and c[k] for c in runs["columns"]]
    assert len(found) == len(records)
    for r in records:
        at = float(f"{r.h if r.controls == 'step' else r.rtol:.6g}")
        shown = dict(zip(data["columns"], found[r.problem, r.integrator, at], strict=True))
        assert shown["residuals"] == pytest.approx(r.work["residuals"], rel=5e-5)
        for group, errors in r.errors.items():
            for norm, error in errors.items():
                column = group if norm == "max" else f"{group}|{norm}"
                assert shown[column] == pytest.approx(error, rel=5e-5)
    # A text per method, then the ties for each accuracy that can be judged.
    place = data["answers"]["a|max|operations"][0]
    assert len(data["verdicts"][place]) == len(data["runs_of"][0]) + len(data["targets"])
