"""How true the pipeline is: rendered trials, exact hulls, distances between surfaces."""
