"""A map server in a thread (real sockets, real HTTP, faults on demand), and a drive to report to it."""

from __future__ import annotations

import gzip
import json
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import pytest

from slamcu_client import Server
from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, InitialPose, Odometry, Record, Sensor
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature, MapIdentity
from slamcu_core.sensoris.proto.data_pb2 import DataMessage
from slamcu_core.sensoris.wire import fields

KEY = "vk_test.0123456789abcdef"


@dataclass
class Answer:
    """What the server says; `cut` bytes of it are kept back and the connection is closed instead."""

    status: int
    document: Any = None
    headers: dict[str, str] = field(default_factory=dict)
    cut: int = 0

    def encode(self) -> bytes:
        return self.document if isinstance(self.document, bytes) else json.dumps(self.document).encode()


Fault = Callable[["FakeServer", "list[bytes]"], "Answer | None"]
"""Called with the bodies of a batch instead of the store; None: hang up without a word."""


def problem(status: int, title: str = "Nothing doing", **headers: str) -> Answer:
    document = {"type": "urn:slamcu:problem:of-a-test", "title": title, "status": status}
    return Answer(status, document, {"Content-Type": "application/problem+json", **headers})


def middleman(status: int) -> list[Answer]:
    """Return what hotspots, proxies and firewalls answer with a status in the server's place."""
    return [
        Answer(status, b"<html>Please log in</html>", {"Content-Type": "text/html"}),
        Answer(status, b"", {}),
        Answer(status, {"type": "about:blank", "title": "No"}, {"Content-Type": "application/problem+json"}),
        Answer(status, {"type": "https://proxy.example/no"}, {"Content-Type": "application/problem+json"}),
        Answer(status, {"type": "urn:slamcu:problem:x"}, {"Content-Type": "text/html"}),
        Answer(status, b"{", {"Content-Type": "application/problem+json"}),
    ]


def hang_up(_server: FakeServer, _bodies: list[bytes]) -> None:
    """Break off before anything is stored."""


def store_and_hang_up(server: FakeServer, bodies: list[bytes]) -> None:
    """Break off when all is stored: the client cannot know."""
    server.store(bodies)


def store_and_break_off(server: FakeServer, bodies: list[bytes]) -> Answer:
    """Break off in the middle of the answer."""
    answer = server.store(bodies)
    answer.cut = 5
    return answer


def say(answer: Answer) -> Fault:
    return lambda _server, _bodies: answer


class FakeServer(ThreadingHTTPServer):
    """Keeps messages by (session, message id) as the real one does, unless a fault is due."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.lock = threading.RLock()
        self.faults: deque[Fault] = deque()
        self.poison: Callable[[bytes], Answer | tuple[str, str] | None] = lambda _body: None
        self.stored: dict[tuple[str, int], bytes] = {}
        self.batches: list[list[tuple[str, int]]] = []
        self.headers_seen: list[dict[str, str]] = []
        self.duplicates = 0
        self.max_batch = 10_000
        self.pages: Callable[[dict[str, str], dict[str, str]], Answer] = lambda _query, _headers: problem(404)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"

    def store(self, bodies: list[bytes]) -> Answer:
        accepted = duplicates = 0
        rejected = []
        for index, (key, body) in enumerate(zip(map(ids_of, bodies), bodies, strict=True)):
            verdict = self.poison(body)
            if isinstance(verdict, Answer):
                return verdict
            if verdict is not None:
                rejected.append({"index": index, "reason": verdict[0], "detail": verdict[1]})
            elif key not in self.stored:
                self.stored[key] = body
                accepted += 1
            elif self.stored[key] == body:
                duplicates += 1
            else:
                rejected.append({"index": index, "reason": "conflicting-bytes", "detail": "the same ids, other bytes"})
        self.duplicates += duplicates
        receipt = {"accepted": accepted, "duplicates": duplicates, "rejected": rejected}
        if rejected and not accepted and not duplicates:
            answer = problem(422, "Nothing accepted")
            answer.document |= receipt
            return answer
        return Answer(202, receipt)


class _Handler(BaseHTTPRequestHandler):
    server: FakeServer
    protocol_version = "HTTP/1.1"
    timeout = 10
    disable_nagle_algorithm = True

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the name of the method that this overrides
        """Stay silent."""

    def do_POST(self) -> None:
        raw = self.rfile.read(int(self.headers["Content-Length"]))
        assert self.headers["Content-Encoding"] == "gzip"
        assert self.headers["Content-Type"] == "application/x-protobuf"
        bodies = split(gzip.decompress(raw))
        server = self.server
        with server.lock:
            server.headers_seen.append(dict(self.headers))
            server.batches.append([ids_of(body) for body in bodies])
            if self.headers["Authorization"] != f"Bearer {KEY}":
                return self._say(problem(401, "Unknown key"))
            if server.faults:
                return self._say(server.faults.popleft()(server, bodies))
            if len(bodies) > server.max_batch:
                return self._say(problem(413))
            return self._say(server.store(bodies))

    def do_GET(self) -> None:
        url = urlsplit(self.path)
        with self.server.lock:
            self.server.headers_seen.append(dict(self.headers))
            if self.headers["Authorization"] != f"Bearer {KEY}":
                return self._say(problem(401, "Unknown key"))
            query = dict(parse_qsl(url.query)) | {"path": url.path}
            return self._say(self.server.pages(query, {k.lower(): v for k, v in self.headers.items()}))

    def _say(self, answer: Answer | None) -> None:
        if answer is None:
            self.close_connection = True
            return
        body = b"" if answer.status == 304 else answer.encode()
        self.send_response(answer.status)
        for name, value in {"Content-Type": "application/json", **answer.headers}.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[: len(body) - answer.cut])
        if answer.cut:
            self.close_connection = True


def split(batch: bytes) -> list[bytes]:
    """Take a DataMessages apart into the very bytes of its messages, as a server that hashes them does."""
    return [payload for number, payload in fields(batch) if number == 2 and payload is not None]


def ids_of(body: bytes) -> tuple[str, int]:
    ids = DataMessage.FromString(body).envelope.ids
    return ids.session_id.value, ids.message_id.value


class Faults:
    """The faults, as a fixture: test files cannot import from here."""

    Answer = Answer
    problem = staticmethod(problem)
    middleman = staticmethod(middleman)
    say = staticmethod(say)
    hang_up = staticmethod(hang_up)
    store_and_hang_up = staticmethod(store_and_hang_up)
    store_and_break_off = staticmethod(store_and_break_off)
    ids_of = staticmethod(ids_of)
    key = KEY


@pytest.fixture
def wait_until() -> Callable[[Callable[[], bool]], None]:
    """A function that waits until a thread has brought something about, and fails if it takes too long."""

    def wait(condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < deadline, "nothing happened"
            time.sleep(0.005)

    return wait


@pytest.fixture
def faults() -> type[Faults]:
    return Faults


@pytest.fixture
def fake() -> Iterator[FakeServer]:
    server = FakeServer()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture
def server(fake: FakeServer) -> Iterator[Server]:
    with Server(fake.url, KEY) as client:
        yield client


# --- a drive to feed ------------------------------------------------------------------------------------------------

SPACING_M, SPEED, RATE_HZ = 40.0, 25.0, 10.0


@dataclass(frozen=True)
class Drive:
    """A straight road to the east with a sign every 40 m, some of which are gone, and what a car sees on it."""

    hd_map: HDMap
    header: DriveHeader
    records: tuple[Record, ...]
    gone: frozenset[int]  # object ids
    seconds: float


def make_drive(signs: int = 12, spacing_m: float = SPACING_M, tail_m: float = 20.0, seed: int = 5) -> Drive:
    frame = LocalFrame(2.1, 48.9)
    gone = frozenset(range(3, signs + 1, 5))
    places = np.stack([30.0 + spacing_m * np.arange(signs), np.full(signs, 4.0)], axis=-1)
    lon, lat = frame.to_geographic(places)
    hd_map = HDMap(
        (
            MapFeature(i + 1, float(lon[i]), float(lat[i]), sign="SPEED_LIMIT", value=str(50 + 10 * (i % 4)))
            for i in range(signs)
        ),
        MapIdentity("test-road", "2026.05.1"),
    )
    header = DriveHeader(
        vehicle_id="veh-007",
        fleet_id="test",
        session_id="drive-1",
        start_time=datetime(2026, 5, 1, 8, tzinfo=UTC),
        initial_pose=InitialPose(2.1, 48.9, 90.0, position_std_m=0.5, heading_std_deg=0.5),
        sensors=(Sensor("front_camera", rate_hz=RATE_HZ, fov_deg=60.0, max_range_m=60.0, min_range_m=2.0),),
    )
    rng = np.random.default_rng(seed)
    records: list[Record] = []
    seconds = (places[-1, 0] + tail_m) / SPEED
    for t in (np.arange(int(seconds * RATE_HZ)) / RATE_HZ).tolist():
        records.append(Odometry(t, SPEED, yaw_rate=0.0))
        away = places - (SPEED * t, 0.0)
        distance, bearing = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
        in_view = (distance > 2.0) & (distance < 60.0) & (np.abs(bearing) < np.deg2rad(30.0))
        items = tuple(
            Detection(
                "traffic_sign",
                range=float(distance[i] + rng.normal(0.0, 0.2)),
                bearing=float(bearing[i] + rng.normal(0.0, 0.005)),
                sign="SPEED_LIMIT",
                value=str(50 + 10 * (i % 4)),
            )
            for i in np.flatnonzero(in_view).tolist()
            if i + 1 not in gone and rng.random() < 0.9
        )
        records.append(DetectionFrame(t, "front_camera", items))
    return Drive(hd_map, header, tuple(records), gone, float(seconds))


@pytest.fixture(scope="session")
def drive() -> Drive:
    return make_drive()


@pytest.fixture(scope="session")
def dense_drive() -> Drive:
    """A drive on which passes end in almost every frame for a while."""
    return make_drive(signs=24, spacing_m=2.5, tail_m=220.0)
