"""All that a route awaits runs on the loop: what is not async is given a thread for each request."""

from collections.abc import Iterator
from inspect import iscoroutinefunction

from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute

from service.daemon.rest.app import ROOMS


def called_by(dependant: Dependant) -> Iterator[object]:
    yield dependant.call
    for each in dependant.dependencies:
        yield from called_by(each)


def is_async(called: object) -> bool:
    return iscoroutinefunction(called) or iscoroutinefunction(type(called).__call__)


def test_no_request_takes_a_thread_for_what_only_looks_something_up() -> None:
    routes = [route for room in ROOMS for router in room.ROUTERS for route in router.routes]
    called = [each for route in routes if isinstance(route, APIRoute) for each in called_by(route.dependant)]
    assert len(called) > 2 * len(routes) > 100
    assert {each for each in called if not is_async(each)} == set()
