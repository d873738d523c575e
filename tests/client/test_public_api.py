from __future__ import annotations

import ast
import inspect
from pathlib import Path

import pytest

import slamcu_client
from slamcu_client import Outbox, Request, Response, Server, Uploader
from slamcu_client.errors import ClientError
from slamcu_core.errors import SlamcuError
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris import serialize_message

PACKAGE = Path(slamcu_client.__file__).parent


def test_the_public_api_is_what_all_names() -> None:
    assert slamcu_client.__all__ == sorted(slamcu_client.__all__, key=lambda name: (name[0].islower(), name))
    public = {
        name for name, value in vars(slamcu_client).items() if not name.startswith("_") and not inspect.ismodule(value)
    }
    assert public == set(slamcu_client.__all__)
    for name in slamcu_client.__all__:
        assert inspect.getdoc(getattr(slamcu_client, name)), name


@pytest.mark.parametrize("name", ["VehicleSession", "Outbox", "Uploader", "MapCache", "Server", "result_features"])
def test_what_one_works_with_shows_how(name: str) -> None:
    text = inspect.getdoc(getattr(slamcu_client, name)) or ""
    assert "::\n" in text or ">>> " in text


def test_every_error_is_fit_to_show_to_a_user() -> None:
    errors = [
        value
        for name in slamcu_client.__all__
        if isinstance(value := getattr(slamcu_client, name), type) and issubclass(value, Exception)
    ]
    assert len(errors) > 5
    assert all(issubclass(error, ClientError) and issubclass(error, SlamcuError) for error in errors)


def test_http_is_spoken_in_one_module() -> None:
    speakers = {
        path.name
        for path in PACKAGE.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if (isinstance(node, ast.Import) and any(name.name.split(".")[0] == "httpx" for name in node.names))
        or (isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "httpx")
    }
    assert speakers == {"transport.py"}


def test_another_transport_can_take_its_place(tmp_path: Path) -> None:
    class Postcards:
        """A transport that is no HTTP at all."""

        def __init__(self) -> None:
            self.sent: list[Request] = []
            self.closed = False

        def send(self, request: Request) -> Response:
            self.sent.append(request)
            return Response(202, {}, b'{"accepted": 1, "duplicates": 0, "rejected": []}')

        def close(self) -> None:
            self.closed = True

    postcards = Postcards()
    with Outbox(tmp_path / "o") as outbox, Server("https://slamcu.example/base/", "key", postcards) as server:
        outbox.put("s", [lambda message_id: serialize_message(ReportMessage("s", message_id))])
        assert Uploader(outbox, server).flush(10.0).accepted == 1
    assert [request.url for request in postcards.sent] == ["https://slamcu.example/base/v1/data-messages"]
    assert postcards.closed
