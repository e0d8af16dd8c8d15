"""Into a pipe, long work says how far it has come in lines: at once, every half minute, and at its end."""

from __future__ import annotations

from guider.commands import screen


def test_lines_where_nobody_watches(monkeypatch):
    now, said = [0.0], []
    monkeypatch.setattr(screen.time, "monotonic", lambda: now[0])
    show = screen._lines(said.append)
    for second in range(0, 101, 10):
        now[0] = float(second)
        show("latent", 100 * second, 10_000, "100/s")
    show("fetching", 5, None, "MB")
    assert said == [
        "latent: 0 of 10,000 100/s",
        "latent: 3,000 of 10,000 100/s, 70 s left",
        "latent: 6,000 of 10,000 100/s, 40 s left",
        "latent: 9,000 of 10,000 100/s, 10 s left",
        "latent: 10,000 of 10,000 100/s",
        "fetching: 5 MB",
    ]
