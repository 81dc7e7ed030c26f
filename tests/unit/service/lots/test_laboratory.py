"""A sieving of the laboratory, and its place beside the instrument's curve."""

from service.lots.laboratory import Sieving


def test_what_passes_a_sieve_lies_below_it() -> None:
    retained_g = {31.5: 0.0, 20: 50.0, 16: 150.0, 12.5: 250.0, 10: 250.0, 8: 150.0, 6.3: 100.0, 4: 40.0}
    passing = Sieving(retained_g=retained_g, pan_g=10.0).passing_percent
    assert list(passing) == sorted(retained_g)
    assert [round(passing[sieve_mm], 9) for sieve_mm in sorted(passing, reverse=True)] == [
        100, 95, 80, 55, 30, 15, 5, 1,
    ]  # fmt: skip
