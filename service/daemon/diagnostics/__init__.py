"""One archive for support: what the daemon, its store and its host say, without secrets."""
