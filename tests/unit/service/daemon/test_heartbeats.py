from service.daemon.heartbeats import Heartbeats


def test_late_parts_are_named():
    heartbeats = Heartbeats({"acquisition": 2, "processing": 10})
    assert heartbeats.late(0) == []
    heartbeats.beat("acquisition", 0)
    heartbeats.beat("processing", 0)
    assert heartbeats.late(2) == []
    assert heartbeats.late(5) == ["acquisition"]
    assert heartbeats.late(11) == ["acquisition", "processing"]
    heartbeats.beat("acquisition", 11)
    assert heartbeats.late(11) == ["processing"]
