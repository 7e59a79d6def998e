"""An S3 server process on the loopback: OpenStack Swift with its S3 interface where it is installed (Debian packages
swift-proxy, swift-account, swift-container, swift-object), else moto's server as a stand-in."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

SWIFT = "swift-proxy-server"
KEY, SECRET, REGION = "test:tester", "testing", "us-east-1"
BUCKET = "drapes"

SWIFT_SERVER = """
[DEFAULT]
bind_ip = 127.0.0.1
bind_port = {port}
workers = 0
swift_dir = {folder}
devices = {folder}/devices
mount_check = false
user = root
log_level = ERROR
[pipeline:main]
pipeline = {pipeline}
[app:{kind}-server]
use = egg:swift#{kind}
"""
SWIFT_FILTERS = """
allow_account_management = true
account_autocreate = true
[filter:tempauth]
use = egg:swift#tempauth
user_test_tester = testing .admin
[filter:s3api]
use = egg:swift#s3api
location = us-east-1
""" + "".join(f"[filter:{n}]\nuse = egg:swift#{n}\n" for n in ("catch_errors", "gatekeeper", "listing_formats", "bulk"))
SWIFT_FILTERS += "[filter:cache]\nuse = egg:swift#memcache\n"


@dataclass(frozen=True)
class S3Server:
    """A running server.

    Attributes:
        kind: ``swift`` or ``moto``.
        port: on 127.0.0.1.
        checks_credentials: wrong ones are refused.
    """

    kind: str
    port: int
    checks_credentials: bool

    def environment(self, port: int | None = None) -> dict[str, str]:
        """What obstore needs to reach it, through a proxy's port if one is given."""
        return {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port or self.port}",
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET,
            "AWS_REGION": REGION,
        }


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


@contextmanager
def s3_server(folder: Path) -> Iterator[S3Server]:
    """The server with an empty bucket, until the end of the block."""
    port = free_port()
    real = shutil.which(SWIFT) is not None and os.environ.get("DRAPEMETER_TEST_S3") != "moto"
    processes = start_swift(folder, port) if real else start_moto(folder, port)
    try:
        wait_for_answer(port)
        server = S3Server("swift" if real else "moto", port, real)
        make_bucket(server)
        yield server
    finally:
        for process in processes:
            process.kill()
            process.wait()


def start_swift(folder: Path, port: int) -> list[subprocess.Popen[bytes]]:
    """Account, container, object and proxy servers on one device."""
    device = folder / "devices" / "d1"
    device.mkdir(parents=True)
    processes = []
    for kind in ("account", "container", "object"):
        own = free_port()
        ring = ["swift-ring-builder", str(folder / f"{kind}.builder")]
        add = ["add", "--region", "1", "--zone", "1", "--ip", "127.0.0.1", "--port", str(own), "--device", "d1"]
        for step in (["create", "4", "1", "0"], [*add, "--weight", "1"], ["rebalance"]):
            subprocess.run([*ring, *step], check=True, capture_output=True)
        text = SWIFT_SERVER.format(port=own, folder=folder, pipeline=f"{kind}-server", kind=kind)
        processes.append(start_swift_server(folder, kind, text))
    pipeline = "catch_errors gatekeeper cache listing_formats bulk s3api tempauth proxy-server"
    text = SWIFT_SERVER.format(port=port, folder=folder, pipeline=pipeline, kind="proxy") + SWIFT_FILTERS
    processes.append(start_swift_server(folder, "proxy", text))
    return processes


def start_swift_server(folder: Path, kind: str, configuration: str) -> subprocess.Popen[bytes]:
    """One of Swift's processes."""
    path = folder / f"{kind}-server.conf"
    path.write_text(configuration)
    with (folder / f"{kind}.log").open("w") as log:
        return subprocess.Popen([f"swift-{kind}-server", str(path)], stdout=log, stderr=log)


def start_moto(folder: Path, port: int) -> list[subprocess.Popen[bytes]]:
    """The stand-in."""
    with (folder / "moto.log").open("w") as log:
        command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
        return [subprocess.Popen(command, stdout=log, stderr=log)]


def wait_for_answer(port: int) -> None:
    """Until something answers HTTP."""
    for _ in range(600):
        try:
            urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=2).close()
        except urllib.error.HTTPError:
            return
        except OSError:
            time.sleep(0.1)
        else:
            return
    raise AssertionError(f"no S3 server came up on port {port}")


def make_bucket(server: S3Server) -> None:
    """An empty bucket."""
    import boto3
    from botocore.config import Config

    client = boto3.client(
        "s3",
        endpoint_url=f"http://127.0.0.1:{server.port}",
        aws_access_key_id=KEY,
        aws_secret_access_key=SECRET,
        region_name=REGION,
        config=Config(s3={"addressing_style": "path"}, retries={"max_attempts": 10}),
    )
    client.create_bucket(Bucket=BUCKET)
