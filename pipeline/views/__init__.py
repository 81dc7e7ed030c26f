"""The silhouettes of a bundle as views: prepared for carving, checked against each other, dropped."""
