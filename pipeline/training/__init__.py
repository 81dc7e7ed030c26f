"""How our own segmentation network is made: synthetic views, architecture, fitting, export.

`layers`, `samples` and `scores` run without PyTorch; nothing here is imported when stones are measured.
"""
