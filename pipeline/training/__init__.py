"""Training of our own segmentation network: synthetic views, architecture, fitting, export, scores.

`image_layers`, `samples` and `scores` run without PyTorch; nothing here is imported when stones are measured.
"""
