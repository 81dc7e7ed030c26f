"""The daemon put together: `build` makes its parts, `parts` lists them, `run` starts and ends them."""
