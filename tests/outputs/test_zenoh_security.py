"""A zenoh configuration file with user and password, and with TLS: strangers read nothing."""

from __future__ import annotations

import json
import queue
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from companion.config import Zenoh
from companion.outputs.zenoh_publisher import ZenohPublisher
from companion.outputs.zenoh_settings import client_settings, file_settings
from companion.types import Event
from tests.outputs.zenoh_help import PATIENCE_S, T0, free_port, outputs, solution

STRANGER_S = 2.0
"""For how long a stranger listens while friends are served."""


def written(path: Path, **settings: Any) -> Path:
    """A zenoh configuration file without scouting."""
    path.write_text(
        json.dumps({"scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
                    **settings})
    )  # fmt: skip
    return path


@contextmanager
def publishing(file: Path) -> Iterator[ZenohPublisher]:
    with closing(ZenohPublisher(Zenoh(config_file=str(file)), "v1")) as publisher:
        assert publisher.link.wait_open(PATIENCE_S), publisher.notices()
        publisher.event(Event(T0, "aligned", "level"))
        publisher.config("secret = true\n")
        publisher.publish(outputs(solution()), 1)
        yield publisher


def heard(settings: zenoh.Config, publisher: ZenohPublisher, seconds: float) -> list[str]:
    """Keys that a subscriber, a query and a look at liveliness get within ``seconds``."""
    keys: queue.Queue[str] = queue.Queue()
    until = time.monotonic() + seconds
    try:
        session = zenoh.open(settings)
    except zenoh.ZError:
        return []
    with session:
        # Kept until the end: an advanced subscription lives as long as its object.
        events = zenoh.ext.declare_advanced_subscriber(
            session,
            "companion/**",
            lambda s: keys.put(str(s.key_expr)),
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        )
        k = 0
        found: set[str] = set()
        while time.monotonic() < until and not found >= EVERYTHING:
            k += 5
            publisher.publish(outputs(solution(first=k)), 1)
            found |= {str(r.ok.key_expr) for r in session.get("companion/**", timeout=0.2) if r.ok}
            found |= {
                str(r.ok.key_expr)
                for r in session.liveliness().get("companion/*/@alive", timeout=0.2)
                if r.ok
            }
            while not keys.empty():
                found.add(keys.get())
        events.undeclare()
    return sorted(found)


EVERYTHING = {f"companion/v1/{name}"
              for name in ("nav/state", "nav/fix", "events", "config", "@alive")}  # fmt: skip


def test_user_and_password_are_needed_to_read_anything(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    users = tmp_path / "users.txt"
    users.write_text("pilot:secret\ncompanion:own\n")
    vehicle = written(
        tmp_path / "vehicle.json5",
        mode="peer",
        listen={"endpoints": [endpoint]},
        transport={"auth": {"usrpwd": {"user": "companion", "password": "own",
                                       "dictionary_file": str(users)}}},
    )  # fmt: skip

    def client(name: str, **usrpwd: str) -> zenoh.Config:
        return file_settings(
            written(
                tmp_path / f"{name}.json5",
                mode="client",
                connect={"endpoints": [endpoint], "timeout_ms": 0, "exit_on_failure": True},
                transport={"auth": {"usrpwd": usrpwd}} if usrpwd else {},
            )
        )

    with publishing(vehicle) as publisher:
        assert heard(client_settings(endpoint), publisher, STRANGER_S) == []
        wrong = client("wrong", user="pilot", password="guess")
        assert heard(wrong, publisher, STRANGER_S) == []
        friend = client("friend", user="pilot", password="secret")
        assert set(heard(friend, publisher, PATIENCE_S)) >= EVERYTHING


def test_tls_with_certificates_of_both_sides(tmp_path: Path) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("no openssl here to make certificates with")
    authority(tmp_path, "ours")
    authority(tmp_path, "theirs")
    for name, by in (("vehicle", "ours"), ("friend", "ours"), ("stranger", "theirs")):
        certificate(tmp_path, name, by)
    port = free_port()
    endpoint = f"tls/localhost:{port}"
    vehicle = written(
        tmp_path / "vehicle.json5",
        mode="peer",
        listen={"endpoints": [f"tls/127.0.0.1:{port}"]},
        transport={"link": {"tls": {
            "root_ca_certificate": str(tmp_path / "ours.pem"),
            "listen_certificate": str(tmp_path / "vehicle.pem"),
            "listen_private_key": str(tmp_path / "vehicle.key"),
            "enable_mtls": True,
        }}},
    )  # fmt: skip

    def client(name: str) -> zenoh.Config:
        return file_settings(
            written(
                tmp_path / f"{name}.json5",
                mode="client",
                connect={"endpoints": [endpoint], "timeout_ms": 0, "exit_on_failure": True},
                transport={"link": {"tls": {
                    "root_ca_certificate": str(tmp_path / "ours.pem"),
                    "connect_certificate": str(tmp_path / f"{name}.pem"),
                    "connect_private_key": str(tmp_path / f"{name}.key"),
                    "enable_mtls": True,
                }}},
            )
        )  # fmt: skip

    with publishing(vehicle) as publisher:
        plain = client_settings(f"tcp/127.0.0.1:{port}")
        assert heard(plain, publisher, STRANGER_S) == []
        assert heard(client("stranger"), publisher, STRANGER_S) == []
        assert set(heard(client("friend"), publisher, PATIENCE_S)) >= EVERYTHING


def openssl(directory: Path, *args: str) -> None:
    subprocess.run(["openssl", *args], cwd=directory, check=True, capture_output=True, timeout=60)


def authority(directory: Path, name: str) -> None:
    """A self-signed certificate authority."""
    openssl(directory, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256",
            "-nodes", "-days", "2", "-subj", f"/CN={name}", "-keyout", f"{name}.key",
            "-out", f"{name}.pem", "-addext", "basicConstraints=critical,CA:TRUE")  # fmt: skip


def certificate(directory: Path, name: str, by: str) -> None:
    """A certificate for localhost, signed by an authority."""
    openssl(directory, "req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes",
            "-subj", f"/CN={name}", "-keyout", f"{name}.key", "-out", f"{name}.csr")  # fmt: skip
    (directory / f"{name}.ext").write_text(
        "subjectAltName=DNS:localhost,IP:127.0.0.1\nextendedKeyUsage=serverAuth,clientAuth\n"
    )
    openssl(directory, "x509", "-req", "-in", f"{name}.csr", "-CA", f"{by}.pem",
            "-CAkey", f"{by}.key", "-CAcreateserial", "-days", "2",
            "-extfile", f"{name}.ext", "-out", f"{name}.pem")  # fmt: skip
