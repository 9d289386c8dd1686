"""What `Farm` and `AsyncFarm` share: addresses, packed scenes, answers."""

import os
import tempfile
import zipfile
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import httpx
from httpx_sse import ServerSentEvent

from .errors import JobUnfinished, Refused
from .rest import AuthenticatedClient
from .rest.models import Event, Job, JobState, Problem
from .rest.types import Response, Unset

T = TypeVar("T")

# States after which nothing happens.
FINAL = {JobState.DONE, JobState.FAILED, JobState.CANCELLED}

# Seconds between attempts to reach a service that went away, and the number of attempts.
PAUSE = 2.0
ATTEMPTS = 30

# Size of the pieces of an upload, bytes.
PIECE = 1 << 16


def client(url: str | None, token: str | None) -> AuthenticatedClient:
    """A client of `url` and `token`, or of the variables that the command line reads."""
    url = url or os.environ.get("FORELIGHT_SERVER") or "http://127.0.0.1:7878"
    token = token or os.environ.get("FORELIGHT_TOKEN")
    if not token:
        raise ValueError("no token: pass one, or set FORELIGHT_TOKEN")
    timeout = httpx.Timeout(30, read=300)
    return AuthenticatedClient(base_url=url, token=token, timeout=timeout, raise_on_unexpected_status=True)


@contextmanager
def packed(scene: Path) -> Iterator[tuple[Path, str]]:
    """The file to upload for a scene, and its media type. A folder is packed into a temporary zip file."""
    if scene.suffix.lower() == ".blend":
        yield scene, "application/x-blender"
    elif scene.is_file():
        yield scene, "application/zip"
    else:
        files = sorted(path for path in scene.rglob("*") if path.is_file())
        if not files:
            raise FileNotFoundError(f"{scene}: no such scene")
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder, "scene.zip")
            with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
                for path in files:
                    archive.write(path, path.relative_to(scene))
            yield target, "application/zip"


def pieces(path: Path) -> Iterator[bytes]:
    """The content of a file."""
    with path.open("rb") as file:
        while piece := file.read(PIECE):
            yield piece


async def apieces(path: Path) -> AsyncIterator[bytes]:
    """The same, for a client that does several things at a time."""
    for piece in pieces(path):
        yield piece


# What the service answers when it has too much to do, and a proxy when the service is away.
BUSY = {429, 502, 503, 504}


class Busy(httpx.TransportError):
    """The service cannot answer now. It may later, as after a lost connection."""


def checked(response: httpx.Response) -> httpx.Response:
    """The answer, unless it is a refusal."""
    if response.status_code in BUSY:
        raise Busy(f"{response.request.url} answered {response.status_code}")
    if response.is_error:
        raise Refused(Problem.from_dict(response.json()))
    return response


def answer(response: Response[Any], kind: type[T]) -> T:
    """The parsed answer, unless it is a refusal."""
    if response.status_code in BUSY:
        raise Busy(f"the service answered {int(response.status_code)}")
    parsed: object = response.parsed
    if isinstance(parsed, Problem):
        raise Refused(parsed)
    assert isinstance(parsed, kind)
    return parsed


def event(message: ServerSentEvent) -> Event:
    """An event of the stream."""
    return Event.from_dict(message.json())


def ends(event: Event) -> bool:
    """Whether nothing follows this event of a job."""
    return not isinstance(event.job_state, Unset) and event.job_state in FINAL


def image_path(folder: Path, frame: int, kind: str) -> Path:
    """Where a frame's image goes: `0012.exr`, `0012.png`, `0012-preview.png`, `0012-cost-map.png`."""
    return folder / f"{frame:04}-{kind}".replace("-image.", ".")


@contextmanager
def whole(path: Path) -> Iterator[BinaryIO]:
    """A file that is at `path` only when all of it was written."""
    unfinished = path.with_name(path.name + ".part")
    try:
        with unfinished.open("wb") as file:
            yield file
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def require_done(job: Job) -> Job:
    """The job, if all of its frames are finished."""
    if job.state is not JobState.DONE:
        raise JobUnfinished(job)
    return job
