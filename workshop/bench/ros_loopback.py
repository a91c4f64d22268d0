"""Variables of processes that speak ROS 2 on this machine alone, by shared memory: no socket, no other robot."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from elastic_strips.errors import ElasticStripsError

_PROFILE = """<?xml version="1.0" encoding="UTF-8" ?>
<dds>
  <profiles xmlns="http://www.eprosima.com">
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>shared_memory</transport_id>
        <type>SHM</type>
        <segment_size>16777216</segment_size>
      </transport_descriptor>
    </transport_descriptors>
    <participant profile_name="shared_memory_only" is_default_profile="true">
      <rtps>
        <userTransports><transport_id>shared_memory</transport_id></userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>
      </rtps>
    </participant>
  </profiles>
</dds>
"""
_FIRST_PORT, _PORTS_OF_DOMAIN = 7400, 250
_DOMAINS = 200  # whose ports there are


@contextmanager
def own_domain() -> Iterator[int]:
    """A domain of ROS that no other process of this machine has by this function: who shares one hears the other's
    robot, too."""
    for number in range(_DOMAINS):
        domain = 1 + (os.getpid() + number) % _DOMAINS
        held = os.open(Path(tempfile.gettempdir()) / f"elastic-strips-domain-{domain}", os.O_CREAT | os.O_RDWR, 0o600)
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(held)
            continue
        try:
            yield domain
        finally:
            os.close(held)  # which lets go of it
        return
    raise ElasticStripsError(f"all {_DOMAINS} domains of ROS are in use on this machine")


def variables(folder: Path, domain: int) -> dict[str, str]:
    """Variables of a process that talks to those of its domain by shared memory alone; its files are in ``folder``."""
    profile = folder / "shared_memory_only.xml"
    profile.write_text(_PROFILE)
    return {
        **{k: v for k, v in os.environ.items() if not k.startswith(("ROS_", "RMW_", "FASTDDS_", "FASTRTPS_"))},
        "FASTDDS_DEFAULT_PROFILES_FILE": str(profile),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "ROS_DOMAIN_ID": str(domain),
        "ROS_LOG_DIR": str(folder / "log"),
        "PYTHONUNBUFFERED": "1",
    }


def ports(domain: int) -> set[str]:
    """Ports in shared memory of a domain: others on this machine may have theirs."""
    first = _FIRST_PORT + _PORTS_OF_DOMAIN * domain
    named = {f"fastdds_port{number}" for number in range(first, first + _PORTS_OF_DOMAIN)}
    return {path.name for path in Path("/dev/shm").glob("fastdds_port*") if path.name in named}


def running(folder: Path) -> list[str]:
    """Command lines of the processes that were started with `variables` of a folder."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if str(folder).encode() in (place / "environ").read_bytes():
                found.append((place / "cmdline").read_bytes().replace(b"\0", b" ").decode())
        except OSError:
            continue
    return found
