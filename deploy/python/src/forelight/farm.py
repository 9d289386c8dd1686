"""The farm, for programs that wait."""

import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Self
from uuid import UUID, uuid4

import httpx
from httpx_sse import connect_sse

from . import wire
from .rest.api.jobs import frame_list, job_get, job_submit
from .rest.models import (
    Bundle,
    BundleRef,
    Confidence,
    Event,
    FramePage,
    FrameState,
    Job,
    JobRequest,
    RenderSettingsRequest,
)
from .rest.types import UNSET, Unset


class Farm:
    """A farm at `url`. Without arguments: `FORELIGHT_SERVER` and `FORELIGHT_TOKEN`, as for the command line.

    `client` is for the functions of `forelight.rest.api`, which cover every route.
    """

    def __init__(self, url: str | None = None, token: str | None = None):
        self.client = wire.client(url, token)

    def __enter__(self) -> Self:
        self.client.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.client.__exit__(kind, error, where)

    def upload(self, scene: str | Path) -> Bundle:
        """Uploads a folder, a zip file or a .blend file. Raises `Refused` if it is not a valid scene."""
        http = self.client.get_httpx_client()
        with wire.packed(Path(scene)) as (path, media_type):
            headers = {"Content-Type": media_type, "Content-Length": str(path.stat().st_size)}
            response = http.post("/v1/bundles", content=wire.pieces(path), headers=headers)
        return Bundle.from_dict(wire.checked(response).json())

    def submit(
        self,
        scene: str | Path,
        frames: str,
        *,
        name: str | None = None,
        project: str | Unset = UNSET,
        deadline: datetime | Unset = UNSET,
        confidence: Confidence | Unset = UNSET,
        budget: int | Unset = UNSET,
        settings: RenderSettingsRequest | Unset = UNSET,
    ) -> Job:
        """Uploads a scene and submits frames of it, such as `0-47`. `budget` is in millionths of the currency.

        Repeats after a lost connection are safe: the service makes one job.
        """
        request = JobRequest(
            bundle=BundleRef(id=self.upload(scene).id),
            name=name or Path(scene).stem,
            frames=frames,
            project=project,
            deadline=deadline,
            confidence=confidence,
            budget=budget,
            settings=settings,
        )
        key = str(uuid4())
        for attempt in range(wire.ATTEMPTS):
            try:
                found = job_submit.sync_detailed(client=self.client, body=request, idempotency_key=key)
                return wire.answer(found, Job)
            except httpx.TransportError:
                if attempt + 1 == wire.ATTEMPTS:
                    raise
                time.sleep(wire.PAUSE)
        raise AssertionError("the last attempt returns or raises")

    def job(self, job: Job | UUID) -> Job:
        """The job as it is now."""
        id = job.id if isinstance(job, Job) else job
        return wire.answer(job_get.sync_detailed(id, client=self.client), Job)

    def follow(self, job: Job) -> Iterator[Event]:
        """The events of a job from its beginning to its end. A lost connection is taken up again."""
        http, last, attempts = self.client.get_httpx_client(), 0, 0
        while attempts < wire.ATTEMPTS:
            headers = {"Last-Event-ID": str(last)}
            try:
                with connect_sse(http, "GET", f"/v1/jobs/{job.id}/events", headers=headers) as source:
                    if source.response.is_error:
                        source.response.read()
                    if wire.checked(source.response).status_code == httpx.codes.NO_CONTENT:
                        return
                    attempts = 0
                    for event in map(wire.event, source.iter_sse()):
                        last = event.id
                        yield event
                        if wire.ends(event):
                            return
            except httpx.TransportError:
                pass
            attempts += 1
            time.sleep(wire.PAUSE)
        raise ConnectionError(f"the service at {http.base_url} went away")

    def wait(self, job: Job) -> Job:
        """Waits for the end of a job. Raises `JobUnfinished` if it fails or is cancelled."""
        for _ in self.follow(job):
            pass
        return wire.require_done(self.job(job))

    def frames(self, job: Job) -> Iterator[int]:
        """Numbers of the finished frames of a job, ascending."""
        token: str | Unset = UNSET
        while True:
            found = frame_list.sync_detailed(job.id, client=self.client, page_token=token)
            page = wire.answer(found, FramePage)
            yield from (row.frame for row in page.items if row.state is FrameState.DONE)
            if isinstance(page.next_page_token, Unset) or page.next_page_token is None:
                return
            token = page.next_page_token

    def fetch(self, job: Job, folder: str | Path, kind: str = "image.exr") -> Iterator[Path]:
        """Writes the images of finished frames into a folder, and returns each path when it is there.

        `kind` is `image.exr`, `image.png`, `preview.png` or `cost-map.png`.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        http = self.client.get_httpx_client()
        for frame in self.frames(job):
            path = wire.image_path(folder, frame, kind)
            with http.stream("GET", f"/v1/jobs/{job.id}/frames/{frame}/{kind}") as response:
                if response.is_error:
                    response.read()
                wire.checked(response)
                with wire.whole(path) as file:
                    for piece in response.iter_bytes():
                        file.write(piece)
            yield path
