"""The runner with real child processes."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from nermo_bringup.launch.description import load
from nermo_bringup.launch.executables import find_executable, find_launch_file
from nermo_bringup.launch.runner import launch
from nermo_description.results import CommandError

LAUNCHER = """
import signal, sys
from pathlib import Path
from nermo_bringup.launch.description import load
from nermo_bringup.launch.runner import Runner
quick = ((signal.SIGINT, float(sys.argv[2])), (signal.SIGTERM, float(sys.argv[2])), (signal.SIGKILL, 10.0))
sys.exit(Runner(load(Path(sys.argv[1]), {}).nodes, stopping=quick).run())
"""
PATIENT = """
import signal, sys, time
try:
    print("waiting", flush=True)
    signal.pause()
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""
STUBBORN = """
import signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("waiting", flush=True)
while True:
    signal.pause()
"""


class Launched:
    """A launcher in a process of its own."""

    def __init__(self, file: Path, patience: float = 10.0, **options) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", LAUNCHER, str(file), str(patience)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            **options,
        )
        self.lines: list[str] = []

    def wait_for(self, *texts: str) -> None:
        """Reads the output until each of the texts has appeared."""
        missing = list(texts)
        while missing:
            line = self.process.stdout.readline()
            assert line, f"ended without {missing}: {self.lines}"
            self.lines.append(line)
            missing = [text for text in missing if text not in line]

    def end(self) -> tuple[int, str]:
        output, _ = self.process.communicate(timeout=60)
        return self.process.returncode, "".join(self.lines) + output

    def pids(self) -> list[int]:
        return [int(line.split()[-1]) for line in self.lines if "started with process id" in line]


def gone(pid: int) -> bool:
    """Whether a process has ended (a zombie that nobody has waited for yet has)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


def wait_until_gone(pids: list[int]) -> None:
    while not all(map(gone, pids)):
        os.sched_yield()


def nodes(*names: str, **attributes: str) -> str:
    more = "".join(f' {key}="{value}"' for key, value in attributes.items())
    return "".join(f'<node pkg="toys" exec="{name}" name="{name}" output="screen"{more}/>\n' for name in names)


def test_one_interrupt_stops_all_in_order(prefix):
    prefix.executable("one", PATIENT)
    prefix.executable("two", PATIENT)
    launched = Launched(prefix.launch_file(nodes("one", "two")))
    launched.wait_for("[one] waiting", "[two] waiting")
    launched.process.send_signal(signal.SIGINT)
    status, output = launched.end()
    assert status == 0
    assert output.count("interrupted") == 2
    wait_until_gone(launched.pids())


def test_interrupt_works_where_it_was_inherited_as_ignored(prefix):
    prefix.executable("one", PATIENT)
    launched = Launched(
        prefix.launch_file(nodes("one")), preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)
    )
    launched.wait_for("waiting")
    launched.process.send_signal(signal.SIGINT)
    status, output = launched.end()
    assert status == 0
    assert "interrupted" in output


def test_what_does_not_stop_is_killed(prefix):
    prefix.executable("stubborn", STUBBORN)
    launched = Launched(prefix.launch_file(nodes("stubborn")), patience=0.1)
    launched.wait_for("waiting")
    launched.process.send_signal(signal.SIGTERM)
    status, output = launched.end()
    assert status == 0
    assert "SIGTERM to what has not stopped: stubborn" in output
    assert "SIGKILL to what has not stopped: stubborn" in output
    wait_until_gone(launched.pids())


def test_further_interrupts_make_haste(prefix):
    prefix.executable("stubborn", STUBBORN)
    launched = Launched(prefix.launch_file(nodes("stubborn")), patience=3600.0)
    launched.wait_for("waiting")
    for expected in ("stopping 1 nodes", "SIGTERM to what", "SIGKILL to what"):
        launched.process.send_signal(signal.SIGINT)
        launched.wait_for(expected)
    assert launched.end()[0] == 0


def test_nothing_survives_a_launcher_that_is_killed_outright(prefix):
    prefix.executable("one", PATIENT)
    prefix.executable("stubborn", STUBBORN)
    launched = Launched(prefix.launch_file(nodes("one", "stubborn")))
    launched.wait_for("[one]      waiting", "[stubborn] waiting")
    launched.process.kill()
    wait_until_gone(launched.pids())


def test_node_that_dies_is_started_again(prefix, tmp_path):
    marker = tmp_path / "lives"
    prefix.executable(
        "mortal",
        f"open({str(marker)!r}, 'a').write('x')\nimport os, signal\n"
        f"if os.path.getsize({str(marker)!r}) < 3: os.kill(os.getpid(), signal.SIGKILL)\n" + PATIENT,
    )
    launched = Launched(prefix.launch_file(nodes("mortal", respawn="true", respawn_delay="0.1")))
    launched.wait_for("waiting")
    launched.process.send_signal(signal.SIGINT)
    status, output = launched.end()
    assert status == 0
    assert output.count("killed by SIGKILL; starting it again in 0.1 s") == 2


def test_interrupt_during_a_respawn_delay_ends_at_once(prefix):
    prefix.executable("mortal", "raise SystemExit(3)")
    launched = Launched(prefix.launch_file(nodes("mortal", respawn="true", respawn_delay="3600")))
    launched.wait_for("ended with exit status 3; starting it again in 3600 s")
    launched.process.send_signal(signal.SIGINT)
    assert launched.end()[0] == 0


def test_failure_of_a_node_is_the_failure_of_the_launch(prefix):
    prefix.executable("bad", "print('oh'); raise SystemExit(3)")
    prefix.executable("good", "print('done')")
    launched = Launched(prefix.launch_file(nodes("bad", "good")))
    status, output = launched.end()
    assert status == 1
    assert output.splitlines()[-1] == "nermo: bad ended with exit status 3."
    assert "[good] done" in output


def test_node_that_refuses_its_parameters_ends_the_launch(prefix):
    line = "[FATAL] [1795509620.298601773] [nermo.picky]: parameter seed = x"
    prefix.executable("picky", f"print({line!r}); raise SystemExit(2)")
    prefix.executable("patient", PATIENT)
    body = nodes("picky", respawn="true", respawn_delay="0.1") + nodes("patient")
    status, output = Launched(prefix.launch_file(body)).end()
    assert status == 2
    assert output.splitlines()[-1] == "nermo: picky refused what it was given: parameter seed = x"
    assert output.count("started with process id") == 2


def test_long_and_unfinished_lines_come_whole(prefix):
    prefix.executable("loud", "print('x' * 300000); print('rest', end='')")
    status, output = Launched(prefix.launch_file(nodes("loud"))).end()
    assert status == 0
    assert f"[loud] {'x' * 300000}\n" in output
    assert "[loud] rest\n" in output


def test_node_that_is_interrupted_while_it_starts_shows_no_traceback(prefix):
    prefix.executable("slow", "import signal\nprint('importing', flush=True)\nsignal.pause()")
    odd = 'Traceback (most recent call last):\\n  File "made", line 1\\n\\nKeyboardInterrupt'
    code = f"import signal, sys\nsignal.signal(2, lambda *_: sys.exit('{odd}'))\n"
    code += "print('waits', flush=True)\nsignal.pause()"
    prefix.executable("odd", code)
    code = "import signal\ntry:\n    print('ready', flush=True); signal.pause()\nfinally:\n    raise ValueError('why')"
    prefix.executable("wrong", code)
    # What a library of C makes of it when its own initialisation is interrupted, and what was handled just then.
    code = "import signal\ntry:\n    print('loading', flush=True); signal.pause()\n"
    code += "except KeyboardInterrupt as e:\n    raise ImportError('initialization failed') from e"
    prefix.executable("library", code)
    code = "import signal\ntry:\n    {}['key']\nexcept KeyError:\n    print('looking', flush=True); signal.pause()"
    prefix.executable("handling", code)
    launched = Launched(prefix.launch_file(nodes("slow", "odd", "wrong", "library", "handling")))
    launched.wait_for("importing", "waits", "ready", "loading", "looking")
    launched.process.send_signal(signal.SIGINT)
    _, output = launched.end()
    assert not [line for line in output.splitlines() if not line.startswith("[wrong]") and "Traceback" in line]
    assert re.search(r"\[wrong\] +ValueError: why", output)
    assert "initialization failed" not in output and "KeyError" not in output
    assert not re.search(r"\[(slow|library|handling)\] +ended with", output)


def test_log_output_shows_errors_only(prefix):
    prefix.executable("quiet", "import sys; print('chatter'); print('trouble', file=sys.stderr)")
    _, output = Launched(prefix.launch_file('<node pkg="toys" exec="quiet" output="log"/>')).end()
    assert "trouble" in output
    assert "chatter" not in output


def test_environment_and_arguments_reach_the_node(prefix):
    prefix.executable("env", "import os, sys; print(os.environ['NERMO_TEST'], sys.argv[1:])")
    body = (
        '<node pkg="toys" exec="env" name="e" namespace="n" output="screen"><env name="NERMO_TEST" value="here"/>'
        '<param name="a" value="1"/></node>'
    )
    _, output = Launched(prefix.launch_file(body)).end()
    assert "here ['--ros-args', '-r', '__node:=e', '-r', '__ns:=/n', '-p', 'a:=1']" in output


def test_executable_that_does_not_exist_is_named_with_those_that_do(prefix):
    prefix.executable("toy", "")
    file = prefix.launch_file(nodes("tyo"))
    with pytest.raises(CommandError, match=r"toys\.launch\.xml:2: .* no executable 'tyo'; it has: toy\.") as caught:
        launch(load(file, {}).nodes)
    assert caught.value.status == 1
    with pytest.raises(CommandError, match="no package 'nothing'"):
        find_executable("nothing", "toy")
    assert find_launch_file("toys", file.name) == file
    with pytest.raises(CommandError, match="no launch file 'other.xml'; it has: toys.launch.xml"):
        find_launch_file("toys", "other.xml")


def test_nothing_to_launch_is_an_error():
    with pytest.raises(CommandError, match="starts no node"):
        launch([])
