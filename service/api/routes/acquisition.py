"""Arm and disarm."""

from fastapi import APIRouter, Depends

from service.api.auth import require
from service.api.context import Context
from service.api.problems import documented
from service.api.schemas import Acquisition, AcquisitionRequest
from service.api.settings import Scope
from service.status import AcquisitionStatus

router = APIRouter(prefix="/acquisition", tags=["acquisition"])


@router.get(
    "", response_model=Acquisition, dependencies=[Depends(require(Scope.READ))], responses=documented()
)
async def acquisition(context: Context) -> AcquisitionStatus:
    """Whether stones are being measured."""
    return context.control.acquisition_status()


@router.put(
    "", response_model=Acquisition, dependencies=[Depends(require(Scope.OPERATE))], responses=documented(409)
)
async def set_acquisition(context: Context, wanted: AcquisitionRequest) -> AcquisitionStatus:
    """Arm or disarm; repeating a request changes nothing, 409 when the current state forbids it."""
    await context.control.set_acquisition(wanted.state)
    return context.control.acquisition_status()
