"""From records to estimates: the one chain that serves live, replay, logs and tests."""
