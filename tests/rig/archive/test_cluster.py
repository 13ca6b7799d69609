"""The documented commands of a cluster listen on this computer alone, or answer who has a certificate."""

import datetime
import importlib.util
import os
import re
import shlex
import shutil
import signal
import socket
import ssl
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig.archive import add_sessions
from tests.acquisition.record.hanging_disk import wait_for

ROOT = Path(__file__).resolve().parents[3]
DOCUMENTS = (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"))
SAMPLES = ROOT / "tests" / "rig" / "data" / "samples"
needs_dask = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason="no Dask here: pip install 'optical-pendulum-rig[test-remote]'",
)
needs_ss = pytest.mark.skipif(shutil.which("ss") is None, reason="needs ss (iproute2)")


def documented() -> list[str]:
    """The commands of Dask that stand in the documents."""
    return [
        command
        for path in DOCUMENTS
        for command in re.findall(
            r"(?:`|^ {4})(dask (?:scheduler|worker)[^`\n]*)", path.read_text(encoding="utf-8"), re.MULTILINE
        )
    ]


def test_every_documented_command_names_the_loopback_or_certificates() -> None:
    found = documented()
    assert {command.split()[1] for command in found} == {"scheduler", "worker"}
    for command in found:
        assert "--host 127.0.0.1" in command or "--tls-ca-file" in command, command
        assert "--dashboard-address 127.0.0.1:" in command, command


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port


def group_of(process: int) -> int:
    try:
        return os.getpgid(process)
    except ProcessLookupError:
        return 0


def listening(group: int) -> set[tuple[str, int]]:
    """The addresses and ports on which processes of a group listen, as the kernel tells `ss`."""
    lines = subprocess.run(["ss", "-Hltnp"], capture_output=True, text=True, check=True).stdout.splitlines()
    return {
        (address, int(port))
        for line in lines
        if any(group_of(int(process)) == group for process in re.findall(r"pid=(\d+)", line))
        for address, _, port in [line.split()[3].rpartition(":")]
    }


@pytest.fixture
def started() -> Iterator["list[subprocess.Popen[bytes]]"]:
    """Processes, each the first of its group, that are ended with all of it."""
    found: list[subprocess.Popen[bytes]] = []
    yield found
    for process in found[::-1]:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def start(started: "list[subprocess.Popen[bytes]]", command: str, folder: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", *shlex.split(command)],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    started.append(process)
    wait_for(lambda: listening(process.pid))


@needs_dask
@needs_ss
def test_scheduler_and_worker_listen_on_the_loopback_alone(
    started: "list[subprocess.Popen[bytes]]", tmp_path: Path
) -> None:
    from distributed import Client

    port = free_port()
    commands = [text for text in documented() if "--tls-ca-file" not in text]
    assert [text.split()[1] for text in commands] == ["scheduler", "worker"]
    for command in commands:
        start(started, command.replace("8786", str(port)).replace("8787", "0"), tmp_path)
    with Client(f"tcp://127.0.0.1:{port}", timeout="60s", set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
        assert client.submit(sum, [1, 2]).result(timeout=60) == 3
        for process in started:
            assert {address for address, _ in listening(process.pid)} == {"127.0.0.1"}


def write_certificates(folder: Path) -> None:
    """Those of the document, and of a stranger: another authority's, with the same names."""
    for ca, own in (("ca.pem", "rig"), ("strange-ca.pem", "stranger")):
        authority = signed("our rigs")
        (folder / ca).write_bytes(authority[0])
        certificate, key = signed("rig.lab", authority)
        (folder / f"{own}.pem").write_bytes(certificate)
        (folder / f"{own}.key").write_bytes(key)


def signed(name: str, authority: tuple[bytes, bytes] | None = None) -> tuple[bytes, bytes]:
    """A certificate and its key; without an authority it is one."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    issuer, by = subject, key
    if authority is not None:
        issuer = x509.load_pem_x509_certificate(authority[0]).subject
        loaded = serialization.load_pem_private_key(authority[1], None)
        assert isinstance(loaded, ec.EllipticCurvePrivateKey)
        by = loaded
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.BasicConstraints(ca=authority is None, path_length=None), critical=True)
        .sign(by, hashes.SHA256())
    )
    return certificate.public_bytes(serialization.Encoding.PEM), key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def answers(port: int, certificate: Path | None) -> bool:
    """Whether somebody with this certificate (and its key beside it), or none, is spoken to."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    if certificate is not None:
        context.load_cert_chain(certificate, certificate.with_suffix(".key"))
    with socket.create_connection(("127.0.0.1", port), timeout=20) as plain:
        try:
            # Dask greets who has come in
            with context.wrap_socket(plain) as inside:
                return inside.recv(1) != b""
        except (ssl.SSLError, ConnectionResetError):
            return False


@needs_dask
@needs_ss
@pytest.mark.slow
@pytest.mark.timeout(240)
def test_between_computers_nobody_is_answered_without_a_certificate(
    started: "list[subprocess.Popen[bytes]]", tmp_path: Path
) -> None:
    """The documented commands; every port that is open to other computers, and a refit through it."""
    write_certificates(tmp_path)
    port = free_port()
    for command in documented():
        if "--tls-ca-file" in command:
            here = command.replace("HOST", "127.0.0.1").replace("8786", str(port)).replace("8787", "0")
            start(started, here, tmp_path)
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    add_sessions(tmp_path / "archive", [tmp_path / "runs"])

    def refit(own: str, ca: str = "ca.pem") -> "subprocess.CompletedProcess[str]":
        names = re.findall(r"(DASK_\w+)=(\S+)", (ROOT / "docs" / "archive.md").read_text(encoding="utf-8"))
        assert [text for _, text in names] == ["ca.pem", "rig.pem", "rig.key"]
        files = {name: text.replace("rig", own).replace("ca.pem", ca) for name, text in names}
        return subprocess.run(
            [sys.executable, "-m", "rig", "archive", "refit", "--cluster", f"tls://127.0.0.1:{port}"],
            cwd=tmp_path,
            env=os.environ | files,
            capture_output=True,
            text=True,
            timeout=200,
        )

    done = refit("rig")
    assert (done.returncode, done.stdout.split(",")[0]) == (0, "2 runs fitted again"), done.stderr
    found = {place for process in started for place in listening(process.pid)}
    open_to_all = {number for address, number in found if address != "127.0.0.1"}
    assert port in open_to_all
    for number in open_to_all:
        assert answers(number, tmp_path / "rig.pem")
        assert not answers(number, tmp_path / "stranger.pem")
        assert not answers(number, None)
    # a stranger, and ours with whom another authority answers
    for own, ca in (("stranger", "ca.pem"), ("rig", "strange-ca.pem")):
        done = refit(own, ca)
        assert (done.returncode, done.stdout) == (2, "")
        assert "no Dask scheduler answers there" in done.stderr
