"""What the proxy lets in: the API and its documentation, however a path is written."""

from __future__ import annotations

import http.client
import json
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.metadata import version
from pathlib import Path
from urllib.parse import unquote

import pytest

from slamcu_client import Server
from slamcu_client.server import is_own_problem
from slamcu_eval.scenario.ports import free_port

ROOT = Path(__file__).parents[2]


class _Replica(BaseHTTPRequestHandler):
    """Answers whatever it is asked, and dies instead of answering what it is told to drop."""

    asked: list[str] = []  # noqa: RUF012  (emptied by each test)

    def do_GET(self) -> None:
        self._answer()

    def do_POST(self) -> None:
        self.asked.append(unquote(self.path))
        self.close_connection = True  # without an answer: what the proxy may send again, it sends again

    def _answer(self) -> None:
        if self.path != "/readyz":
            self.asked.append(unquote(self.path))
        self.send_response(200)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *args: object) -> None:
        pass


def _command(configuration: Path) -> list[str]:
    if found := shutil.which("haproxy"):
        return [found, "-db", "-f", str(configuration)]
    image = f"slamcu-proxy:{version('slamcu-server')}"
    mounted = f"{configuration.parent}:{configuration.parent}:ro"
    run = ["docker", "run", "--rm", "--init", "--network", "host", "--volume", mounted, "--entrypoint", "haproxy"]
    return [*run, image, "-db", "-f", str(configuration)]


@contextmanager
def _running(command: list[str]) -> Iterator[None]:
    process = subprocess.Popen(command)
    try:
        yield
    finally:
        process.terminate()
        process.wait(30)


@pytest.fixture
def proxy(tmp_path: Path) -> Iterator[int]:
    """The port of a proxy with the configuration that is shipped, but for its addresses, before one replica."""
    port = free_port()
    with ThreadingHTTPServer(("127.0.0.1", 0), _Replica) as replica:
        threading.Thread(target=replica.serve_forever, daemon=True).start()
        text = (ROOT / "containers" / "haproxy.cfg").read_text(encoding="utf-8")
        text = text.replace("bind :8000", f"bind 127.0.0.1:{port}").replace(" resolvers docker init-addr none", "")
        text = re.sub(r"^resolvers docker\n(    .*\n)+", "", text, flags=re.MULTILINE)
        text = text.replace("api-1:8000", f"127.0.0.1:{replica.server_port}")
        text = re.sub(r"^    server api-2 .*\n", "", text, flags=re.MULTILINE)
        text = text.replace("/etc/haproxy/", f"{tmp_path}/")
        for page in (ROOT / "containers").glob("*.http"):
            shutil.copy(page, tmp_path)
        tmp_path.chmod(0o755)
        configuration = tmp_path / "haproxy.cfg"
        configuration.write_text(text, encoding="utf-8")
        with _running(_command(configuration)):
            deadline = time.monotonic() + 60
            while _ask(port, "GET", "/v1/maps") != 200:
                assert time.monotonic() < deadline
                time.sleep(0.1)
            _Replica.asked.clear()
            yield port
        replica.shutdown()


def _ask(port: int, method: str, path: str) -> int | None:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)  # which sends a path as it is given
    try:
        connection.request(method, path)
        return connection.getresponse().status
    except (OSError, http.client.HTTPException):
        return None
    finally:
        connection.close()


@pytest.mark.parametrize("name", ["metrics", "readyz"])
def test_what_is_for_the_inside_is_not_let_in(proxy: int, name: str) -> None:
    first, rest = f"{ord(name[0]):02x}", name[1:]
    written = [f"/{name}", f"/{name}?x=1", f"/{name}/", f"//{name}", f"/./{name}", f"/%2e/{name}", f"/x/../{name}"]
    written += [f"/{name.upper()}", f"/%{first}{rest}", f"/%{first.upper()}{rest}", f"/%2f{name}", f"/{name};x"]
    written += [f"/%00{name}", f"http://slamcu.test/{name}", f"http://slamcu.test/%{first}{rest}"]
    for path in written:
        assert _ask(proxy, "GET", path) in {400, 404}, path
    assert _Replica.asked == []


def test_the_api_and_its_documentation_are_let_in(proxy: int) -> None:
    documentation = ["/docs", "/docs/static/swagger-ui.css", "/redoc", "/openapi.json"]
    for path in ("/v1/maps", "/v1/maps/a%20town/features?bbox=1,2,3,4", *documentation, "/livez"):
        assert _ask(proxy, "GET", path) == 200, path
    assert _Replica.asked == ["/v1/maps", "/v1/maps/a town/features?bbox=1,2,3,4", *documentation]


def test_what_it_answers_itself_is_the_word_of_a_slamcu_server(proxy: int) -> None:
    """A car with a wrong path in its address stops, where it would have waited for a hotspot to go away."""
    with Server(f"http://127.0.0.1:{proxy}/prefix", "key") as server:
        _, response = server.exchange("POST", "/v1/data-messages")
    assert response.status == 404
    assert is_own_problem(response)
    assert _Replica.asked == []


@pytest.mark.parametrize("page", sorted((ROOT / "containers").glob("*.http")), ids=lambda page: page.stem)
def test_its_pages_are_problem_documents(page: Path) -> None:
    head, body = page.read_text(encoding="utf-8").split("\n\n", 1)
    problem = json.loads(body)
    assert head.startswith(f"HTTP/1.0 {page.stem} ")
    assert "Content-Type: application/problem+json" in head.splitlines()
    assert problem["status"] == int(page.stem)
    assert problem["type"].startswith("urn:slamcu:problem:")


@pytest.mark.parametrize(
    ("path", "sent"), [("/v1/data-messages", 4), ("/v1/changes/1/review", 1), ("/v1/changes/1/%72eview", 1)]
)
def test_only_reports_are_sent_again(proxy: int, path: str, sent: int) -> None:
    assert _ask(proxy, "POST", path) in {502, 503}
    assert _Replica.asked == [unquote(path)] * sent
