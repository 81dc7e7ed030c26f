from drivers.errors import LossCause
from service.acquisition.common_cause import DeviceLoss, common_cause


def test_cameras_that_are_all_silent_are_the_switch():
    losses = [
        DeviceLoss("does not answer", LossCause.SILENT),
        DeviceLoss("no camera at 127.0.0.1", LossCause.SILENT),
    ]
    assert common_cause(losses).startswith("all 2 cameras are gone: look at the switch")


def test_cameras_that_answer_and_belong_to_someone_else_are_not_the_switch():
    taken = DeviceLoss("is in use by another application", LossCause.IN_USE)
    silent = DeviceLoss("does not answer", LossCause.SILENT)
    assert (
        common_cause([taken, silent])
        == "all 2 cameras are lost, the first one: is in use by another application"
    )
