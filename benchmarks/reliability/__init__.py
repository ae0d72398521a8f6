"""How the tool bears bad links, bad logs and long flights: the figures of docs/reliability.md."""
