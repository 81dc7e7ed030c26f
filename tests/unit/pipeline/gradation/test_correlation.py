"""Vector G4 of the domain notes: a correlation study finds the mapping that lots were made with."""

from collections.abc import Callable

import numpy as np
import pytest
from support.stones import lot_of_sizes

from pipeline.arrays import Values
from pipeline.gradation.correlation import MappingForm, SievedLot, correlated, study
from pipeline.gradation.evaluation import evaluate

SIEVES_MM = (5.6, 8.0, 10.0, 11.2, 12.5, 14.0, 16.0, 20.0, 22.4, 31.5)


def sieved_lots(n: int, sieve_of: Callable[[Values], Values], seed: int = 1) -> list[SievedLot]:
    """Return lots whose stones a laboratory's sieves find as `sieve_of` has it, with an error of 0.5 points."""
    rng = np.random.default_rng(seed)
    lots = []
    for _ in range(n):
        sizes_mm = np.exp(rng.normal(np.log(rng.uniform(10, 13)), np.log(1.35), 500))
        lot = lot_of_sizes(sizes_mm)
        sieved = evaluate(lot_of_sizes(sizes_mm).with_sizes(sieve_of(sizes_mm)), SIEVES_MM)
        passing = {
            point.sieve_mm: float(np.clip((point.by_mass.value or 0.0) + 0.5 * rng.standard_normal(), 0, 100))
            for point in sieved.curve
        }
        lots.append(SievedLot(lot=lot, passing=passing))
    return lots


def test_vector_g4() -> None:
    found = study(sieved_lots(8, lambda sizes_mm: 0.97 * sizes_mm), MappingForm.FACTOR)
    assert found.mapping.factor == pytest.approx(0.97, rel=0.005)
    (relative_se,) = found.mapping.relative_se
    assert relative_se is not None
    assert abs(np.log(found.mapping.factor / 0.97)) < 4 * relative_se
    assert found.raw_rmse > 2
    assert found.raw_bias < -1, "too large stones pass too little"
    assert found.rmse < 1
    assert found.held_out_rmse is not None
    assert found.held_out_rmse < 1
    assert (found.n_lots, found.n_points > 40) == (8, True)


def test_a_monotone_mapping_is_better_where_the_factor_depends_on_the_size() -> None:
    lots = sieved_lots(8, lambda sizes_mm: sizes_mm * (0.93 + 0.005 * sizes_mm))
    factor, monotone = study(lots, MappingForm.FACTOR), study(lots, MappingForm.MONOTONE)
    assert factor.held_out_rmse is not None
    assert monotone.held_out_rmse is not None
    assert monotone.held_out_rmse < 0.7 * factor.held_out_rmse
    sizes_mm = np.linspace(1.0, 60.0, 500)
    assert (np.diff(monotone.mapping(sizes_mm)) > 0).all()
    assert monotone.mapping(np.array([12.0])) == pytest.approx(12.0 * 0.99, rel=0.01)


def test_a_lot_that_behaves_otherwise_shows_on_held_out_lots() -> None:
    lots = sieved_lots(3, lambda sizes_mm: sizes_mm) + sieved_lots(1, lambda sizes_mm: 0.8 * sizes_mm, seed=2)
    found = study(lots, MappingForm.MONOTONE)
    assert found.held_out_rmse is not None
    assert found.held_out_rmse > found.rmse


def test_one_lot_is_no_validation() -> None:
    found = study(sieved_lots(1, lambda sizes_mm: 0.97 * sizes_mm), MappingForm.FACTOR)
    assert found.held_out_rmse is None
    assert found.mapping.relative_se == (None,)


def test_lots_are_correlated_stone_by_stone() -> None:
    (sieved,) = sieved_lots(1, lambda sizes_mm: 0.97 * sizes_mm)
    mapping = study([sieved], MappingForm.FACTOR).mapping
    sizes_mm = sieved.lot.column("sieve_size_mm")
    assert correlated(sieved.lot, mapping).column("sieve_size_mm") == pytest.approx(mapping.factor * sizes_mm)


def test_curves_without_a_steep_part_are_refused() -> None:
    lot = lot_of_sizes(np.full(10, 8.0))
    for form in MappingForm:
        with pytest.raises(ValueError, match="between 5 and 95 %"):
            study([SievedLot(lot=lot, passing={4.0: 0.0, 16.0: 100.0})], form)
