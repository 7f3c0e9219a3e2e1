"""A diagnosis and the page that shows it: what happens becomes what is told."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import typer

from simgap.analysis.experiment import Experiment
from simgap.analysis.stages import Cause, Checked, Decided, Leading, Located, Staged
from simgap.data.plant import Plant
from simgap.live.player import Player
from simgap.live.server import PageServer
from simgap.live.story import STEPS, Story
from simgap.report.evidence import Evidence
from simgap.report.html import colours, page
from simgap.report.progress import waterfall
from simgap.report.sentences import number, plain, sentences, title

Report = dict[str, Any]
Progress = Callable[[str, float], None]

PATIENCE_S = 10.0
"""So long the end of a command waits for browsers to fetch what they show, or for one that comes back."""
LOOK_S = 0.05
"""Between two looks at the button while nothing is played."""


class Live:
    """The page of one diagnosis; with a ``player`` it has a button that plays the next experiment."""

    def __init__(self, host: str, port: int, player: Player | None = None) -> None:
        self._story, self._player = Story(), player
        text = (files("simgap.live") / "page" / "index.html").read_text(encoding="utf-8")
        steps = "".join(f'<li data-step="{s}"><b>{s}</b><i></i><small></small></li>' for s in STEPS)
        text = text.replace("/*colours*/", colours()).replace("<!--steps-->", steps)
        self._server = PageServer(self._story, text, host, port, player)

    @property
    def address(self) -> str:
        """What to open."""
        return self._server.address

    def beside(self, say: Progress) -> Progress:
        """Progress that is told here too."""

        def both(stage: str, share: float) -> None:
            self._story.progress(stage, share)
            say(stage, share)

        return both

    def staged(self, result: Staged) -> None:
        """What is known so far."""
        match result:
            case Checked():
                content = {"channels": result.channels, "runs": result.runs, "duration": result.duration_s}
                self._story.tell("checked", content | {"warnings": result.warnings})
            case Located():
                spoken = [plain(f"{name}@{site}") for name, site, _ in result.spoken]
                shares = list(result.shares.items())[:8]
                self._story.tell("located", {"shares": shares, "candidates": result.candidates, "spoken": spoken})
            case Leading():
                promising = [plain(key) for key in result.promising]
                leaders = [(plain(leader.effects), leader.gain, leader.low, leader.high) for leader in result.leaders]
                content = {"causes": [_told(c) for c in result.causes], "before": result.before, "after": result.after}
                self._story.tell("leading", content | {"leaders": leaders, "promising": promising})
            case Decided():
                causes = [
                    _told(Cause(e["name"], e["site"], {n: (p["value"], p["unit"]) for n, p in e["parameters"].items()}))
                    for e in result.effects
                ]
                content = {"causes": causes, "before": result.before, "after": result.after}
                self._story.tell("decided", content | {"verdict": result.verdict, "reasons": result.reasons})

    def writes(self) -> None:
        """The answer is there, and its report is written."""
        self._story.progress("report", 0.0)

    def finished(self, report: Report, evidence: Evidence, file: Path | None) -> None:
        """The report is written; ``file`` is where, None where only diagnosis.json was asked for."""
        # Before the last event, upon which browsers fetch it.
        self._server.report = page(report, evidence).encode()
        proposed = report["next_experiment"]
        commands = report.get("what_to_do", {}).get("commands", [])
        content = {
            "title": title(report),
            "verdict": report["verdict"],
            "sentences": sentences(report),
            "waterfall": waterfall(report).svg(),
            "curves": _curves(evidence),
            "next": proposed["description"] if proposed else None,
            "experiment": str(file.resolve().with_name(proposed["file"])) if proposed and file else None,
            "commands": commands,
            "warnings": report["warnings"],
            "file": str(file.resolve()) if file else None,
            "wall": report["wall_s"],
            "playable": self._player is not None and proposed is not None,
        }
        self._story.tell("finished", content, last=not content["playable"])

    def play(self, experiment: Experiment, plant: Plant) -> None:
        """Play an experiment as often as somebody holds the button, until every page is closed again, or Ctrl-C."""
        if (player := self._player) is None:
            return

        def tell(sentence: str) -> None:
            self._story.tell("told", {"sentence": sentence})

        self._story.tell("playable", {"robot": player.robot, "prepare": player.prepare})
        with contextlib.suppress(KeyboardInterrupt):
            gone = math.inf
            while time.monotonic() - gone < PATIENCE_S:
                if player.held():
                    self._story.tell("plays", {})
                    self._story.tell("played", vars(player.play(experiment, plant, tell)))
                if self._server.readers:
                    gone = time.monotonic()
                time.sleep(LOOK_S)
        self._story.tell("over", {}, last=True)

    def failed(self, sentence: str) -> None:
        """It ends without an answer."""
        self._story.tell("failed", {"sentence": sentence}, last=True)

    def close(self) -> None:
        """End when every open page has all that it shows."""
        self._server.close(PATIENCE_S)


def _told(cause: Cause) -> dict[str, str]:
    values = (f"{n.replace('_', ' ')} {number(v)} {u}".removesuffix(" 1").strip() for n, (v, u) in cause.values.items())
    return {"name": plain(f"{cause.effect}@{cause.site}"), "values": ", ".join(values)}


def _curves(evidence: Evidence) -> list[dict[str, Any]]:
    return [
        {
            "channel": name,
            "unit": unit,
            "windows": [
                {"start": w.start} | {k: getattr(w, k).tolist() for k in ("time", "measured", "nominal", "after")}
                for w in windows
            ],
        }
        for (name, unit), windows in evidence.curves.items()
    ]


@contextlib.contextmanager
def watched(web: bool, host: str, port: int, player: Player | None = None) -> Iterator[Live | None]:
    """While a diagnosis runs: its page, or None where none is wanted. How it fails is told there too.

    ``player`` plays the next experiment, if `Live.play` is called.

    Raises:
        GapInputError: the page cannot be there.
    """
    if not web:
        yield None
        return
    live = Live(host, port, player)
    typer.echo(f"watch it at {live.address}", err=True)
    try:
        yield live
    except KeyboardInterrupt:
        live.failed("It was interrupted.")
        raise
    except Exception as error:
        live.failed(str(error) or type(error).__name__)
        raise
    finally:
        live.close()
