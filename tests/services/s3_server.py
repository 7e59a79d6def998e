"""An S3 server process on the loopback: OpenStack Swift with its S3 interface where it is installed (Debian packages
swift-proxy, swift-account, swift-container, swift-object), else moto's server as a stand-in."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.services.ports import free_port

SWIFT = "swift-proxy-server"
KEY, SECRET, REGION = "test:tester", "testing", "us-east-1"
BUCKET = "drapes"
MOTO = [sys.executable, "-m", "moto.server"]

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


@dataclass
class S3Server:
    """A server, running or killed.

    Attributes:
        kind: ``swift`` or ``moto``.
        port: on 127.0.0.1.
        commands: its processes' command lines by port; the one that answers clients comes last.
        folder: of logs and, but for moto, of the data.
        processes: those that run.
    """

    kind: str
    port: int
    commands: dict[int, list[str]]
    folder: Path
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def checks_credentials(self) -> bool:
        """Wrong ones are refused."""
        return self.kind == "swift"

    @property
    def keeps_data(self) -> bool:
        """What was stored is there when it is started again."""
        return self.kind == "swift"

    def start(self) -> None:
        """Start it, again if it was killed, on the same port and data; returns when it answers.

        What answers clients is started when the others answer: without them it says that there is no such bucket.
        """
        for port, command in self.commands.items():
            with (self.folder / f"{Path(command[0]).name}.log").open("a") as log:
                self.processes.append(subprocess.Popen(command, stdout=log, stderr=log))
            wait_for_answer(port)

    def kill(self) -> None:
        """SIGKILL for all its processes, first the one that answers clients."""
        while self.processes:
            process = self.processes.pop()
            process.kill()
            process.wait()

    def environment(self, port: int | None = None) -> dict[str, str]:
        """What obstore needs to reach it, through a proxy's port if one is given."""
        return {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port or self.port}",
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET,
            "AWS_REGION": REGION,
        }


@contextmanager
def s3_server(folder: Path) -> Iterator[S3Server]:
    """The server with an empty bucket, until the end of the block."""
    port = free_port()
    real = shutil.which(SWIFT) is not None and os.environ.get("DRAPEMETER_TEST_S3") != "moto"
    commands = lay_out_swift(folder, port) if real else {port: [*MOTO, "-H", "127.0.0.1", "-p", str(port)]}
    server = S3Server("swift" if real else "moto", port, commands, folder)
    try:
        server.start()
        make_bucket(server)
        yield server
    finally:
        server.kill()


def lay_out_swift(folder: Path, port: int) -> dict[int, list[str]]:
    """Rings and configurations of account, container, object and proxy servers on one device; command lines by port."""
    device = folder / "devices" / "d1"
    device.mkdir(parents=True)
    ports: dict[str, int] = {}
    configurations = {}
    for kind in ("account", "container", "object"):
        own = ports[kind] = free_port()
        ring = ["swift-ring-builder", str(folder / f"{kind}.builder")]
        add = ["add", "--region", "1", "--zone", "1", "--ip", "127.0.0.1", "--port", str(own), "--device", "d1"]
        for step in (["create", "4", "1", "0"], [*add, "--weight", "1"], ["rebalance"]):
            subprocess.run([*ring, *step], check=True, capture_output=True)
        configurations[kind] = SWIFT_SERVER.format(port=own, folder=folder, pipeline=f"{kind}-server", kind=kind)
    pipeline = "catch_errors gatekeeper cache listing_formats bulk s3api tempauth proxy-server"
    proxy = SWIFT_SERVER.format(port=port, folder=folder, pipeline=pipeline, kind="proxy") + SWIFT_FILTERS
    for kind, text in (configurations | {"proxy": proxy}).items():
        (folder / f"{kind}-server.conf").write_text(text)
    ports["proxy"] = port
    return {own: [f"swift-{kind}-server", str(folder / f"{kind}-server.conf")] for kind, own in ports.items()}


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
