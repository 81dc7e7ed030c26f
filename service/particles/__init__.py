"""Results one by one: their meshes, pictures, outlines and caliper points, as files that clients ask for."""
