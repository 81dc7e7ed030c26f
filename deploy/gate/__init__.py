"""The gate: checks of the source and tests, side by side, with what each of them took."""
