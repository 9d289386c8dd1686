"""What the Python package says of refusals and of a job that ended: `python_client_peer.py SCENE IMAGES`."""

import asyncio
import sys
from pathlib import Path

from forelight import AsyncFarm, Farm, JobUnfinished, Refused
from forelight.rest.api.jobs import job_cancel, job_list
from forelight.rest.models import JobPage


def refusals(scene: str) -> None:
    with Farm() as farm:
        try:
            farm.submit(scene, "0-", name="wrong frames")
            raise AssertionError("a set of frames without an end was accepted")
        except Refused as refused:
            assert refused.problem.status == 422 and refused.problem.pointer == "/frames", refused
        try:
            farm.upload(__file__)
            raise AssertionError("a file that is no scene was accepted")
        except Refused as refused:
            assert refused.problem.status in (400, 422), refused
        page = job_list.sync(client=farm.client)
        assert isinstance(page, JobPage) and len(page.items) == 2, "refused jobs leave nothing behind"
    with Farm(token="not-a-token") as stranger:
        try:
            stranger.upload(scene)
            raise AssertionError("an unknown token was accepted")
        except Refused as refused:
            assert refused.problem.status == 401, refused


async def cancelled(scene: str) -> None:
    async with AsyncFarm() as farm:
        job = await farm.submit(scene, "0-47", name="cancelled")
        await job_cancel.asyncio(job.id, client=farm.client)
        try:
            await farm.wait(job)
            raise AssertionError("a cancelled job is not done")
        except JobUnfinished as unfinished:
            assert unfinished.job.id == job.id


def images(folder: Path) -> None:
    found = {path.name: path.read_bytes()[:4] for path in folder.iterdir()}
    assert sorted(found) == ["0000.exr", "0000.png", "0001.exr", "0001.png"], sorted(found)
    assert all(start == (b"\x76\x2f\x31\x01" if name.endswith("exr") else b"\x89PNG") for name, start in found.items())


if __name__ == "__main__":
    images(Path(sys.argv[2]))
    refusals(sys.argv[1])
    asyncio.run(cancelled(sys.argv[1]))
