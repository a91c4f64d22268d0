"""Command log: leaving out superfluous commands does not change the picture."""

from __future__ import annotations

import umsgpack
from hypothesis import given
from hypothesis import strategies as st

from elastic_strips.viewer import commands
from elastic_strips.viewer.server import CommandLog

_PATHS = ("/a", "/a/b", "/a/bc", "/ab", "/a/b/c")
_KINDS = ("object", "instances", "transforms", "property visible", "delete")


def executed(items):
    """The picture: what a browser knows after these commands."""
    state: dict[str, dict[str, bytes]] = {}
    for key, payload in items:
        path, _, kind = key.partition("\0")
        if kind == "delete":
            for old in [p for p in state if p == path or p.startswith(path + "/")]:
                del state[old]
            continue
        if kind == "object" and path in state:
            state[path].pop("instances", None)
        if kind == "instances" and "object" not in state.get(path, {}):
            continue  # nothing there that could be placed
        state.setdefault(path, {})[kind] = payload
    return {path: kinds for path, kinds in state.items() if kinds}


_log = st.lists(st.tuples(st.sampled_from(_PATHS), st.sampled_from(_KINDS), st.binary(max_size=2)), max_size=40)


@given(_log)
def test_a_new_browser_sees_the_same_picture(log):
    items = [(commands.key(path, kind), payload) for path, kind, payload in log]
    items = [
        item for k, item in enumerate(items) if not item[0].endswith("instances") or _has_object(items[:k], item[0])
    ]
    record = CommandLog()
    record.extend(items)
    assert executed(record.items()) == executed(items)
    assert not any(key.endswith("delete") for key, _ in record.items())


@given(_log, _log)
def test_a_slow_browser_ends_with_the_same_picture(first, second):
    items = [(commands.key(path, kind), payload) for path, kind, payload in first + second]
    items = [
        item for k, item in enumerate(items) if not item[0].endswith("instances") or _has_object(items[:k], item[0])
    ]
    cut = len(items) // 2
    pending = CommandLog(deletions=True)
    pending.extend(items[cut:])
    assert executed(items[:cut] + pending.items()) == executed(items)
    assert len(pending) <= len(items) - cut


def _has_object(before, key):
    return "object" in executed(before).get(key.split("\0")[0], {})


def test_a_batch_is_one_array():
    record = CommandLog()
    record.extend([commands.visible("/a", True), commands.delete("/b"), commands.hud({"title": "t"})])
    assert [c["type"] for c in umsgpack.unpackb(record.take())] == ["set_property", "hud"]
    assert len(record) == 0
    assert umsgpack.unpackb(record.take()) == []


def test_what_plays_comes_last():
    record = CommandLog()
    record.extend([commands.no_animation(), commands.visible("/a", True), commands.animation([], 30.0)])
    assert [c["type"] for c in umsgpack.unpackb(record.batch())] == ["set_property", "set_animation"]
