"""Ground rules for every test: a ROS graph of its own, no display, nothing written into the home folder."""

import fcntl
import importlib.util
import os
import sys
import tempfile
from pathlib import Path

import hypothesis
import pytest

# Domains above 101 reach into the port range that Linux gives to anybody.
_DOMAINS = range(1, 102)
# Files with one of these words in their name bring nodes up; their tests run one by one.
_GRAPH_WORDS = {"demo", "graph", "node", "nodes"}
# A test that has one of these marks takes long.
_LONG = ("long", "slow", "timeout")
_held = None


def _lease_domain():
    """Holds a ROS domain that no other test process of this machine uses, by a lock that ends with this process."""
    global _held
    folder = Path(tempfile.gettempdir()) / "nermo_test_domains"
    folder.mkdir(exist_ok=True)
    for domain in _DOMAINS:
        file = (folder / str(domain)).open("w")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            continue
        _held = file
        return domain
    raise pytest.UsageError(
        f"all ROS domains from {_DOMAINS.start} to {_DOMAINS.stop - 1} are taken by other test runs"
    )


def pytest_configure(config):
    # A busy machine is no failure: no test asserts how long something takes. The same examples every time, so that a
    # change is judged by itself; NERMO_HYPOTHESIS=explore looks for new ones.
    hypothesis.settings.register_profile("nermo", deadline=None, derandomize=True)
    hypothesis.settings.register_profile("explore", deadline=None, max_examples=400)
    hypothesis.settings.load_profile(os.environ.get("NERMO_HYPOTHESIS", "nermo"))
    # Helper modules of tests stand beside them.
    sys.path.extend(map(str, sorted(Path(__file__).parent.glob("src/*/test"))))
    os.environ["ROS_DOMAIN_ID"] = str(_lease_domain())
    if importlib.util.find_spec("rclpy"):
        from nermo_node.network import loopback

        os.environ.update(loopback(os.environ))
    os.environ.setdefault("ROS_LOG_DIR", os.path.join(tempfile.gettempdir(), "nermo_test_logs"))
    os.environ.setdefault("MUJOCO_GL", "egl")
    os.environ.setdefault("MPLBACKEND", "Agg")


def pytest_collection_modifyitems(items):
    for item in items:
        if _GRAPH_WORDS & set(item.path.stem.split("_")):
            item.add_marker(pytest.mark.ros)
    # Begun last, a long test would leave the other workers idle. Files stay whole, for what their tests share.
    long = {item.path for item in items if any(item.get_closest_marker(name) for name in _LONG)}
    items.sort(key=lambda item: item.path not in long)
