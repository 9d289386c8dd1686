"""What can go wrong beside the network."""

from .rest.models import Job, Problem
from .rest.types import Unset


class Refused(Exception):
    """The service refused a request. `problem` says why (RFC 9457)."""

    def __init__(self, problem: Problem):
        place = problem.pointer or problem.parameter
        super().__init__(f"{problem.title}: {problem.detail}" + (f" (at {place})" if place else ""))
        self.problem = problem


class JobUnfinished(Exception):
    """A job failed or was cancelled, so its images do not exist. `job` has its last state."""

    def __init__(self, job: Job):
        reason = "" if isinstance(job.error, Unset) or not job.error else f": {job.error}"
        super().__init__(f"job {job.name} is {job.state.value}{reason}")
        self.job = job
