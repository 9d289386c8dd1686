"""The farm, for programs that do several things at a time."""

import asyncio
from collections.abc import AsyncIterator
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Self
from uuid import UUID, uuid4

import httpx
from httpx_sse import aconnect_sse

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


class AsyncFarm:
    """The same as `Farm`, with `async` methods."""

    def __init__(self, url: str | None = None, token: str | None = None):
        self.client = wire.client(url, token)

    async def __aenter__(self) -> Self:
        await self.client.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        await self.client.__aexit__(kind, error, where)

    async def upload(self, scene: str | Path) -> Bundle:
        """Uploads a folder, a zip file or a .blend file. Raises `Refused` if it is not a valid scene."""
        http = self.client.get_async_httpx_client()
        with wire.packed(Path(scene)) as (path, media_type):
            headers = {"Content-Type": media_type, "Content-Length": str(path.stat().st_size)}
            response = await http.post("/v1/bundles", content=wire.apieces(path), headers=headers)
        return Bundle.from_dict(wire.checked(response).json())

    async def submit(
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
            bundle=BundleRef(id=(await self.upload(scene)).id),
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
                found = await job_submit.asyncio_detailed(client=self.client, body=request, idempotency_key=key)
                return wire.answer(found, Job)
            except httpx.TransportError:
                if attempt + 1 == wire.ATTEMPTS:
                    raise
                await asyncio.sleep(wire.PAUSE)
        raise AssertionError("the last attempt returns or raises")

    async def job(self, job: Job | UUID) -> Job:
        """The job as it is now."""
        id = job.id if isinstance(job, Job) else job
        return wire.answer(await job_get.asyncio_detailed(id, client=self.client), Job)

    async def follow(self, job: Job) -> AsyncIterator[Event]:
        """The events of a job from its beginning to its end. A lost connection is taken up again."""
        http, last, attempts = self.client.get_async_httpx_client(), 0, 0
        while attempts < wire.ATTEMPTS:
            headers = {"Last-Event-ID": str(last)}
            try:
                async with aconnect_sse(http, "GET", f"/v1/jobs/{job.id}/events", headers=headers) as source:
                    if source.response.is_error:
                        await source.response.aread()
                    if wire.checked(source.response).status_code == httpx.codes.NO_CONTENT:
                        return
                    attempts = 0
                    async for message in source.aiter_sse():
                        event = wire.event(message)
                        last = event.id
                        yield event
                        if wire.ends(event):
                            return
            except httpx.TransportError:
                pass
            attempts += 1
            await asyncio.sleep(wire.PAUSE)
        raise ConnectionError(f"the service at {http.base_url} went away")

    async def wait(self, job: Job) -> Job:
        """Waits for the end of a job. Raises `JobUnfinished` if it fails or is cancelled."""
        async for _ in self.follow(job):
            pass
        return wire.require_done(await self.job(job))

    async def frames(self, job: Job) -> AsyncIterator[int]:
        """Numbers of the finished frames of a job, ascending."""
        token: str | Unset = UNSET
        while True:
            found = await frame_list.asyncio_detailed(job.id, client=self.client, page_token=token)
            page = wire.answer(found, FramePage)
            for row in page.items:
                if row.state is FrameState.DONE:
                    yield row.frame
            if isinstance(page.next_page_token, Unset) or page.next_page_token is None:
                return
            token = page.next_page_token

    async def fetch(self, job: Job, folder: str | Path, kind: str = "image.exr") -> AsyncIterator[Path]:
        """Writes the images of finished frames into a folder, and returns each path when it is there.

        `kind` is `image.exr`, `image.png`, `preview.png` or `cost-map.png`.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        http = self.client.get_async_httpx_client()
        async for frame in self.frames(job):
            path = wire.image_path(folder, frame, kind)
            async with http.stream("GET", f"/v1/jobs/{job.id}/frames/{frame}/{kind}") as response:
                if response.is_error:
                    await response.aread()
                wire.checked(response)
                with wire.whole(path) as file:
                    async for piece in response.aiter_bytes():
                        file.write(piece)
            yield path
