"""Submits a scene, prints the quote beside the true cost, and fetches the images.

python example.py SCENE FRAMES FOLDER      needs FORELIGHT_SERVER and FORELIGHT_TOKEN
"""

import asyncio
import sys

from forelight import AsyncFarm, Farm
from forelight.rest.api.jobs import job_forecast
from forelight.rest.models import ForecastDoc, RenderSettingsRequest

DRAFT = RenderSettingsRequest(width=160, height=90, spp=4)


def render(scene: str, frames: str, folder: str) -> None:
    with Farm() as farm:
        job = farm.submit(scene, frames, settings=DRAFT)
        for event in farm.follow(job):
            if event.message:
                print(event.message)
        job = farm.wait(job)
        quote = job_forecast.sync(job.id, client=farm.client)
        assert isinstance(quote, ForecastDoc)
        print(f"quoted {quote.total.cpu_seconds.mean:.2f} CPU seconds, P95 {quote.total.cpu_seconds.p95:.2f}")
        for path in farm.fetch(job, folder):
            print(path)


async def pictures(scene: str, frames: str, folder: str) -> None:
    async with AsyncFarm() as farm:
        job = await farm.wait(await farm.submit(scene, frames, settings=DRAFT))
        async for path in farm.fetch(job, folder, "image.png"):
            print(path)


if __name__ == "__main__":
    render(*sys.argv[1:])
    asyncio.run(pictures(*sys.argv[1:]))
