from __future__ import annotations

import errno
import gzip
import json
import os
import pty
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from slamcu_client import Outbox
from slamcu_client.atomic_file import replacing
from slamcu_client.cli import main
from slamcu_core.formats import read_results, write_drive_log, write_hd_map
from slamcu_core.hd_map import MapFeature, MapIdentity
from slamcu_core.sensoris import decode_message


@pytest.fixture
def folder(tmp_path: Path, drive, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with map.geojson, drive.jsonl and drive.jsonl.gz, and the key in the environment."""
    (tmp_path / "map.geojson").write_text("".join(write_hd_map(drive.hd_map.identity, drive.hd_map)))
    text = "".join(write_drive_log(drive.header, drive.records))
    (tmp_path / "drive.jsonl").write_text(text)
    (tmp_path / "drive.jsonl.gz").write_bytes(gzip.compress(text.encode()))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SLAMCU_API_KEY", raising=False)
    return tmp_path


@pytest.fixture
def key(faults, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("SLAMCU_API_KEY", faults.key)
    return faults.key


@pytest.fixture
def vehicle(capfd: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    def run(*arguments: str) -> tuple[int, str, str]:
        code = main([*arguments, *(["--particles", "20"] if arguments[0] == "drive" else [])])
        out, err = capfd.readouterr()
        return code, out, err

    return run


LOCAL = ("drive", "--map", "map.geojson", "--log", "drive.jsonl")
FETCH = ("fetch-map", "--map", "m", "--server", "http://localhost:1", "--api-key", "k")


def test_a_drive_without_a_server(folder: Path, vehicle, drive) -> None:
    code, out, err = vehicle(*LOCAL, "--result", "out.geojson")
    assert (code, err) == (0, "")
    assert f"normal {len(drive.hd_map) - len(drive.gone):>13}\n  deleted {len(drive.gone):>12}\n" in out
    with (folder / "out.geojson").open() as file:
        results = list(read_results(file))
    assert {one.map_object_id: one.state for one in results} == {
        one.object_id: "deleted" if one.object_id in drive.gone else "normal" for one in drive.hd_map
    }
    assert all((one.passes, one.vehicles) == (1, 1) for one in results)
    assert not list(folder.glob("*.outbox")), "nothing to report to, nothing left behind"


def test_a_gzipped_log_gives_the_same_result_whatever_its_name(folder: Path, vehicle) -> None:
    vehicle(*LOCAL, "--result", "plain.geojson")
    (folder / "misnamed.jsonl").write_bytes((folder / "drive.jsonl.gz").read_bytes())
    assert vehicle(*LOCAL[:3], "--log", "misnamed.jsonl", "--result", "packed.geojson")[0] == 0
    assert (folder / "packed.geojson").read_text() == (folder / "plain.geojson").read_text()


def test_the_seed_decides(folder: Path, vehicle) -> None:
    for name, seed in (("a", "7"), ("b", "7"), ("c", "8")):
        assert vehicle(*LOCAL, "--seed", seed, "--result", name)[0] == 0
    assert Path("a").read_text() == Path("b").read_text() != Path("c").read_text()


def test_a_drive_reports_to_the_server(folder: Path, vehicle, fake, key, drive) -> None:
    code, out, err = vehicle(*LOCAL, "--server", fake.url)
    assert (code, err) == (0, "")
    passes = [one for body in fake.stored.values() for one in decode_message(body).passes]
    assert {one.reference.object_id for one in passes if one.reference} == {one.object_id for one in drive.hd_map}
    assert f"{len(passes)} reported" in out
    assert f"{len(fake.stored)} accepted, 0 known already, 0 rejected, 0 waiting" in out
    assert [path.name for path in folder.glob("*.outbox*")] == ["drive.jsonl.outbox"]
    with Outbox("drive.jsonl.outbox") as outbox:
        assert outbox.stats().pending == 0


def test_the_key_may_come_from_a_file(folder: Path, vehicle, fake, faults, monkeypatch) -> None:
    (folder / "key").write_text(f"{faults.key}\n")
    monkeypatch.setenv("SLAMCU_API_KEY_FILE", "key")
    assert vehicle(*LOCAL, "--server", fake.url)[0] == 0
    assert fake.stored
    monkeypatch.setenv("SLAMCU_API_KEY_FILE", "no such file")
    code, _, err = vehicle(*LOCAL, "--server", fake.url)
    assert (code, err) == (1, "slamcu-vehicle: no such file: No such file or directory\n")


def test_a_key_file_that_is_no_text_is_told_in_one_line(folder: Path, vehicle, monkeypatch) -> None:
    (folder / "key").write_bytes(b"vk_\xff\xfe")
    monkeypatch.setenv("SLAMCU_API_KEY_FILE", "key")
    code, out, err = vehicle(*LOCAL, "--server", "http://localhost")
    assert (code, out, err) == (1, "", "slamcu-vehicle: key: holds no API key: it is not UTF-8 text\n")


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ((b"drive", b"--map-name", b"t\xff", b"--log", b"drive.jsonl", b"--server", b"http://localhost"), 2),
        ((b"fetch-map", b"--map", b"t\xff", b"--out", b"o", b"--server", b"http://localhost"), 2),
        ((b"fetch-map", b"--map", b"t", b"--out", b"o", b"--server", b"http://local\xffhost"), 1),
        ((b"fetch-map", b"--map", b"t", b"--out", b"no/\xff", b"--server", b"http://localhost:1"), 1),
        ((b"upload", b"--outbox", b"\xff", b"--server", b"http://localhost"), 1),
        ((b"upload", b"--outbox", b"o", b"--server", b"http://localhost", b"--api-key", b"\xff"), 1),
        ((b"drive", b"--map", b"map.geojson", b"--log", b"\xff"), 1),
        ((b"drive", b"--map", b"map.geojson", b"--log", b"drive.jsonl", b"--seed", b"\xff"), 2),
    ],
)
def test_arguments_that_are_no_text_are_told_without_a_traceback(folder: Path, arguments, code: int) -> None:
    Outbox("o").close()
    environment = os.environ | {"SLAMCU_API_KEY": "key", "PYTHONIOENCODING": "utf-8:strict"}
    command = [sys.executable.encode(), b"-m", b"slamcu_client", *arguments]
    done = subprocess.run(command, capture_output=True, check=False, env=environment)
    assert done.returncode == code
    told = done.stderr.decode().splitlines()
    assert told[-1].startswith("slamcu-vehicle")
    assert "Traceback" not in done.stderr.decode()
    assert code == 2 or len(told) == 1


def test_files_may_have_names_that_are_no_text(folder: Path, fake, faults) -> None:
    document = json.loads(Path("map.geojson").read_text()) | {"next": None}
    fake.pages = lambda query, _headers: faults.Answer(200, document, {"ETag": '"1"'})
    command = [sys.executable.encode(), b"-m", b"slamcu_client", b"fetch-map", b"--map", b"test-road"]
    command += [b"--server", fake.url.encode(), b"--out", b"m\xff.geojson"]
    environment = os.environ | {"SLAMCU_API_KEY": faults.key, "PYTHONIOENCODING": "utf-8:strict"}
    done = subprocess.run(command, capture_output=True, check=False, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(b"m\\udcff.geojson: test-road")
    assert Path(os.fsdecode(b"m\xff.geojson")).exists()


def test_a_log_can_be_driven_at_a_pace(folder: Path, vehicle, drive, monkeypatch) -> None:
    now, slept = [100.0], []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now[0] += seconds

    monkeypatch.setattr("slamcu_client.commands.time.monotonic", lambda: now[0])
    monkeypatch.setattr("slamcu_client.commands.time.sleep", sleep)
    code, out, _ = vehicle(*LOCAL, "--pace", "4")
    assert code == 0
    assert "normal" in out
    assert sum(slept) == pytest.approx(drive.records[-1].t / 4)
    with pytest.raises(SystemExit):
        vehicle(*LOCAL, "--pace", "0")


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize(
    ("options", "kept"), [((), ""), (("--outbox", "car.outbox"), "; what is in the outbox stays there")]
)
def test_an_interrupted_drive_tells_of_an_outbox_where_there_is_one(
    folder: Path, vehicle, monkeypatch, options: tuple[str, ...], kept: str
) -> None:
    monkeypatch.setattr("slamcu_client.commands.time.sleep", lambda _s: signal.raise_signal(signal.SIGINT))
    code, _, err = vehicle(*LOCAL, *options, "--pace", "1")
    assert code == 130
    assert err.splitlines()[-1] == f"slamcu-vehicle: interrupted{kept}"


def with_a_sign_to_watch(drive) -> str:
    """The drive's map as it is once the cloud has a candidate: vehicles report what they see of that too."""
    first = next(iter(drive.hd_map))
    watched = MapFeature(900, first.lon, first.lat + 5e-5, sign=first.sign, value=first.value, tile_id=-1)
    return "".join(write_hd_map(drive.hd_map.identity, [*drive.hd_map, watched]))


def test_a_drive_driven_twice_is_reported_once(folder: Path, vehicle, fake, key, drive) -> None:
    vehicle(*LOCAL, "--server", fake.url)
    before, asked = dict(fake.stored), len(fake.batches)
    for text in (Path("map.geojson").read_text(), with_a_sign_to_watch(drive)):
        Path("map.geojson").write_text(text)
        code, out, err = vehicle(*LOCAL, "--server", fake.url, "--result", "again.geojson")
        assert code == 0
        assert err == "slamcu-vehicle: this drive has been reported before: nothing of it is reported again\n"
        assert "0 accepted, 0 known already, 0 rejected, 0 waiting" in out
        assert Path("again.geojson").exists()
    assert fake.stored == before
    assert len(fake.batches) == asked


def test_a_drive_that_another_outbox_has_reported_is_known_to_the_server(folder: Path, vehicle, fake, key) -> None:
    vehicle(*LOCAL, "--server", fake.url)
    before = dict(fake.stored)
    code, out, err = vehicle(*LOCAL, "--server", fake.url, "--outbox", "another.outbox")
    assert (code, err) == (0, "")
    assert f"0 accepted, {len(before)} known already" in out
    assert fake.stored == before


@pytest.mark.parametrize("at_once", [True, False], ids=["while driving", "by upload"])
def test_of_a_drive_that_was_reported_against_another_map_nothing_counts_twice(
    folder: Path, vehicle, fake, key, drive, *, at_once: bool
) -> None:
    """The outbox that remembered is lost, and the map has changed: the same drive makes other messages."""
    vehicle(*LOCAL, "--server", fake.url)
    # as if the first run had made fewer messages: what comes after a conflict is new to the server
    del fake.stored[max(fake.stored)]
    before = dict(fake.stored)
    Path("map.geojson").write_text(with_a_sign_to_watch(drive))
    outbox_and_server = "--outbox", "another.outbox", "--server", fake.url
    if at_once:
        code, out, err = vehicle(*LOCAL, *outbox_and_server)
    else:
        assert vehicle(*LOCAL, "--outbox", "another.outbox")[0] == 0
        code, out, err = vehicle("upload", *outbox_and_server)
    assert code == 3
    assert err.startswith(f"slamcu-vehicle: {drive.header.session_id}: the server has other reports of this session")
    assert err.count("\n") == 1
    assert "0 accepted" in out
    assert fake.stored == before
    with Outbox("another.outbox") as outbox:
        assert outbox.stats().pending == 0


def test_days_offline_and_then_upload(folder: Path, vehicle, fake, key) -> None:
    code, out, _ = vehicle(*LOCAL, "--outbox", "car.outbox", "--result", "out.geojson")
    assert code == 0
    with Outbox("car.outbox") as outbox:
        waiting = outbox.stats().pending
    assert waiting > 0
    code, out, err = vehicle("upload", "--outbox", "car.outbox", "--server", "http://127.0.0.1:1", "--wait", "0")
    assert code == 3
    assert f"{waiting} waiting" in out
    code, out, err = vehicle("upload", "--outbox", "car.outbox", "--server", fake.url)
    assert (code, err) == (0, "")
    assert f"{waiting} accepted" in out
    assert len(fake.stored) == waiting


def test_a_server_that_is_away_costs_no_result_and_no_report(folder: Path, vehicle, fake, key) -> None:
    code, _, err = vehicle(*LOCAL, "--server", "http://127.0.0.1:1", "--wait", "0", "--result", "out.geojson")
    assert code == 3
    assert "wait in drive.jsonl.outbox" in err
    assert "the newest attempt failed: POST http://127.0.0.1:1/v1/data-messages: cannot connect" in err
    assert Path("out.geojson").exists()
    assert vehicle("upload", "--outbox", "drive.jsonl.outbox", "--server", fake.url)[0] == 0
    assert fake.stored


def test_plain_http_to_another_machine_is_warned_of_in_one_line(folder: Path, key) -> None:
    Outbox("car.outbox").close()  # empty: nothing is sent
    command = [sys.executable, "-m", "slamcu_client", "upload", "--outbox", "car.outbox", "--server"]
    done = subprocess.run([*command, "http://plain.example"], capture_output=True, check=True, text=True)
    (line,) = done.stderr.splitlines()
    assert line.startswith("slamcu-vehicle: plain.example is spoken to over plain http")
    done = subprocess.run([*command, "http://127.0.0.1:1"], capture_output=True, check=True, text=True)
    assert done.stderr == ""


def test_a_key_that_is_not_accepted(folder: Path, vehicle, fake) -> None:
    code, _, err = vehicle(*LOCAL, "--server", fake.url, "--api-key", "wrong-key", "--result", "out.geojson")
    assert code == 1
    assert "the API key is not accepted" in err
    assert "wrong-key" not in err
    assert "wait in drive.jsonl.outbox" in err
    assert Path("out.geojson").exists(), "the local result does not depend on the server"


def test_rejected_reports_are_named(folder: Path, vehicle, fake, key) -> None:
    fake.poison = lambda _body: ("unknown-map", "there is no map test-road here")
    code, out, err = vehicle(*LOCAL, "--server", fake.url, "--outbox", "car.outbox")
    assert code == 3
    assert "unknown-map there is no map test-road here" in err
    assert ", 0 waiting" in out


def test_a_map_by_name_is_fetched(folder: Path, vehicle, fake, faults, key) -> None:
    document = json.loads(Path("map.geojson").read_text()) | {"next": None}
    fake.pages = lambda query, _headers: faults.Answer(200, document, {"ETag": '"1"'})
    code, out, err = vehicle("drive", "--map-name", "test-road", "--log", "drive.jsonl", "--server", fake.url)
    assert (code, err) == (0, "")
    assert "map test-road 2026.05.1: 12 features" in out
    code, out, err = vehicle("fetch-map", "--server", fake.url, "--map", "test-road", "--out", "fetched.geojson")
    assert (code, err) == (0, "")
    assert "12 features and 0 to watch" in out
    assert vehicle("drive", "--map", "fetched.geojson", "--log", "drive.jsonl")[0] == 0
    fake.pages = lambda query, _headers: faults.problem(503)
    code, _, err = vehicle("fetch-map", "--server", fake.url, "--map", "test-road", "--out", "fetched.geojson")
    assert code == 3
    assert "the server answered 503, Nothing doing: this is the copy of" in err


def test_a_box_may_cross_the_antimeridian(folder: Path, vehicle, fake, faults, key) -> None:
    sides = [MapFeature(1, 179.99, -16.8), MapFeature(2, -179.99, -16.8)]
    document = json.loads("".join(write_hd_map(MapIdentity("fiji", "1"), sides))) | {"next": None}
    asked: list[str] = []

    def page(query: dict[str, str], _headers: object) -> object:
        asked.append(query["bbox"])
        return faults.Answer(200, document, {"ETag": '"1"'})

    fake.pages = page
    command = ("fetch-map", "--server", fake.url, "--map", "fiji", "--out", "fiji.geojson")
    code, out, err = vehicle(*command, "--bbox=179.9,-17,-179.9,-16.5")
    assert (code, out, err) == (0, "fiji.geojson: fiji 1, 2 features and 0 to watch\n", "")
    assert asked == ["179.9000000,-17.0000000,-179.9000000,-16.5000000"]


def test_a_car_without_a_map_asks_again_as_long_as_it_waits(folder: Path, vehicle, fake, faults, monkeypatch) -> None:
    document = json.loads(Path("map.geojson").read_text()) | {"next": None}
    answers = [faults.problem(503), faults.problem(503), faults.Answer(200, document, {"ETag": '"1"'})]
    fake.pages = lambda query, _headers: answers.pop(0)
    monkeypatch.setenv("SLAMCU_API_KEY", faults.key)
    monkeypatch.setattr("slamcu_client.commands._MAP_RETRY_S", 0.01)
    drive = ("drive", "--map-name", "test-road", "--log", "drive.jsonl", "--server", fake.url)
    assert vehicle(*drive)[0] == 0
    assert answers == []
    fake.pages = lambda query, _headers: faults.problem(503)
    code, _, err = vehicle(*drive, "--wait", "0")
    assert code == 1
    assert err.startswith("slamcu-vehicle: the map test-road cannot be had: GET http")
    assert "answered 503" in err


def _run(*arguments: str, **streams: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "slamcu_client", *arguments, "--particles", "20"]
    return subprocess.run(command, check=False, text=True, stderr=subprocess.PIPE, **streams)


def test_a_reader_that_has_seen_enough_costs_no_report(folder: Path, fake, key) -> None:
    reading, writing = os.pipe()
    os.close(reading)  # as `| head -1` does after its line
    done = _run(*LOCAL, "--server", fake.url, stdout=writing)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")
    assert fake.stored
    with Outbox("drive.jsonl.outbox") as outbox:
        assert outbox.stats().pending == 0, "all is delivered"


def test_a_full_disk_under_the_output_is_told_and_costs_no_report(folder: Path, fake, key) -> None:
    with Path("/dev/full").open("w") as full:
        done = _run(*LOCAL, "--server", fake.url, stdout=full)
    assert (done.returncode, done.stderr) == (1, "slamcu-vehicle: standard output: No space left on device\n")
    assert fake.stored


@pytest.mark.parametrize(("closed", "code"), [(">&-", 0), ("2>&-", 0), (">&- 2>&-", 0)])
def test_output_may_be_closed(folder: Path, closed: str, code: int) -> None:
    command = f'"{sys.executable}" -m slamcu_client {" ".join(LOCAL)} --particles 20 --result out.geojson {closed}'
    done = subprocess.run(command, shell=True, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (code, "")
    assert Path("out.geojson").exists()


def test_a_file_that_cannot_be_written_is_named_and_not_its_temporary(folder: Path) -> None:
    for trouble in (OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()):
        with pytest.raises(type(trouble)) as caught, replacing(Path("map.geojson")):
            raise trouble
        if isinstance(caught.value, OSError):
            assert (caught.value.filename, caught.value.strerror) == ("map.geojson", "No space left on device")
    with pytest.raises(OSError, match=r"nowhere/x\.geojson"), replacing(Path("nowhere/x.geojson")):
        pass
    with pytest.raises(OSError, match="other"), replacing(Path("map.geojson")):
        raise FileNotFoundError(errno.ENOENT, "No such file", "other")
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


def _spoil(path: Path, line: int, change: Callable[[dict], dict | str]) -> None:
    lines = path.read_text().splitlines()
    changed = change(json.loads(lines[line - 1]))
    lines[line - 1] = changed if isinstance(changed, str) else json.dumps(changed)
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("line", "change", "message"),
    [
        (300, lambda _: "{broken", "line 300"),
        (300, lambda record: {**record, "t": 0.0}, "line 300"),
        (300, lambda record: {**record, "t": "soon"}, "line 300, field t"),
        (1, lambda header: {**header, "sensors": []}, "line"),
        (1, lambda header: {**header, "start_time": "yesterday"}, "start_time"),
    ],
)
def test_a_bad_line_is_named_and_nothing_is_half_done(
    *, folder: Path, vehicle, fake, key, line: int, change, message: str
) -> None:
    _spoil(folder / "drive.jsonl", line, change)
    before = set(folder.iterdir())
    code, out, err = vehicle(*LOCAL, "--server", fake.url, "--result", "out.geojson")
    assert (code, out) == (1, "")
    assert err.count("\n") == 1, "one line, no traceback"
    assert err.startswith("slamcu-vehicle: drive.jsonl, line")
    assert message in err
    assert set(folder.iterdir()) == before
    assert fake.stored == {}


def test_a_result_is_not_touched_by_a_drive_that_fails(folder: Path, vehicle) -> None:
    Path("out.geojson").write_text("what was there before")
    _spoil(folder / "drive.jsonl", 390, lambda _: "{")
    assert vehicle(*LOCAL, "--result", "out.geojson")[0] == 1
    assert Path("out.geojson").read_text() == "what was there before"
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("drive", "--map", "nowhere.geojson", "--log", "drive.jsonl"), "nowhere.geojson: No such file"),
        (("drive", "--map", "map.geojson", "--log", "nowhere"), "nowhere: No such file"),
        (("drive", "--map", "drive.jsonl", "--log", "drive.jsonl"), "drive.jsonl, line"),
        (("drive", "--map", "map.geojson", "--log", "map.geojson"), "map.geojson, line 1"),
        (("drive", "--map", "map.geojson", "--log", "cut.jsonl.gz"), "gzip packing is broken"),
        ((*LOCAL, "--result", "no/such/folder.geojson"), "there is no folder no/such"),
        ((*LOCAL, "--result", "."), ".: is a folder"),
        ((*FETCH, "--out", "no/m"), "there is no folder no"),
        ((*FETCH, "--out", "."), ".: is a folder"),
        ((*LOCAL, "--outbox", "map.geojson"), "map.geojson: is there, but is not an outbox"),
        ((*LOCAL, "--server", "example.org", "--api-key", "k"), "a server's address looks like"),
        (("upload", "--outbox", "nowhere", "--server", "http://x", "--api-key", "k"), "no such outbox"),
    ],
)
def test_what_the_user_must_mend_is_told_in_one_line(folder: Path, vehicle, arguments, message: str) -> None:
    (folder / "cut.jsonl.gz").write_bytes((folder / "drive.jsonl.gz").read_bytes()[:-100])
    code, out, err = vehicle(*arguments)
    assert (code, out) == (1, "")
    assert err.count("\n") == 1
    assert message in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (LOCAL[:3], "--log"),
        (("drive", "--log", "drive.jsonl"), "--map"),
        (("drive", "--log", "drive.jsonl", "--map-name", "town"), "--map-name needs --server"),
        ((*LOCAL, "--map-name", "town", "--server", "http://x"), "not allowed with"),
        ((*LOCAL, "--server", "http://x"), "SLAMCU_API_KEY"),
        ((*LOCAL, "--seed", "-1"), "whole number"),
        ((*LOCAL, "--wait", "nan"), "seconds"),
        (("fetch-map", "--server", "http://x", "--map", "m", "--out", "o", "--bbox", "1,2,3"), "four numbers"),
        (("fetch-map", "--server", "http://x", "--map", "m", "--out", "o", "--bbox=1,4,3,2"), "south <= north"),
        (("fetch-map", "--server", "http://x", "--map", "m", "--out", "o", "--bbox=1,2,181,4"), "[-180, 180]"),
        (("fetch-map", "--server", "http://x", "--map", "m", "--out", "o", "--bbox=nan,2,3,4"), "[-180, 180]"),
    ],
)
def test_wrong_usage_is_explained(folder: Path, capfd, arguments, message: str) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert message in capfd.readouterr().err


def test_too_few_particles_are_refused(folder: Path, capfd) -> None:
    assert main([*LOCAL, "--particles", "1"]) == 1
    assert "particles must be a whole number in [2" in capfd.readouterr().err


@pytest.mark.parametrize("command", [[], ["drive"], ["fetch-map"], ["upload"]])
def test_help_teaches(capfd, command: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*command, "--help"])
    assert stop.value.code == 0
    text = capfd.readouterr().out
    assert "SLAMCU_API_KEY" in text
    assert "exit codes" in text


def test_a_terminal_gets_a_progress_bar_and_a_pipe_does_not(folder: Path) -> None:
    command = [sys.executable, "-m", "slamcu_client", *LOCAL, "--particles", "20"]
    ours, theirs = pty.openpty()
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=theirs, check=True, text=True)
    os.close(theirs)
    seen = b""
    while True:
        try:
            piece = os.read(ours, 4096)
        except OSError:  # the other end is closed: all has been read
            break
        if not piece:
            break
        seen += piece
    os.close(ours)
    assert b"driving [#" in seen
    assert b"%" in seen
    assert "12 features" in done.stdout
    piped = subprocess.run(command, capture_output=True, check=True, text=True)
    assert piped.stderr == ""


def test_a_drive_killed_with_9_is_taken_up_again(folder: Path, vehicle, fake, key) -> None:
    """Kill the command when its first reports have arrived; run it again: each message is with the server once."""
    assert vehicle(*LOCAL, "--server", fake.url)[0] == 0
    expected = dict(fake.stored)
    fake.stored.clear()
    Path("drive.jsonl.outbox").unlink()
    arrived, killed = threading.Event(), threading.Event()

    def store_and_say_nothing(server, bodies) -> None:
        server.store(bodies)
        arrived.set()
        killed.wait(60.0)

    fake.faults.append(store_and_say_nothing)
    command = [sys.executable, "-m", "slamcu_client", *LOCAL, "--server", fake.url, "--particles", "20"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert arrived.wait(60.0)
        child.kill()
        killed.set()
    assert child.returncode == -signal.SIGKILL
    assert 0 < len(fake.stored) <= len(expected)
    assert Path("drive.jsonl.outbox").exists()
    code, out, _ = vehicle(*LOCAL, "--server", fake.url)
    assert code == 0
    assert "0 known already" not in out, "what had arrived without an answer was sent again, and recognised"
    assert fake.stored == expected
