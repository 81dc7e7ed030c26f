"""Files that outlive a crash: bundles, recordings, meshes, silhouettes, rigs."""
