"""Client of the render-farm scheduler forelight.

`Farm` and `AsyncFarm` submit a scene, follow its job, and fetch the images. `forelight.rest` has a function for
every route of the service, with typed requests and answers, sync and async. It is made from the service's
OpenAPI document.
"""

from .async_farm import AsyncFarm
from .errors import JobUnfinished, Refused
from .farm import Farm

__all__ = ["AsyncFarm", "Farm", "JobUnfinished", "Refused"]
