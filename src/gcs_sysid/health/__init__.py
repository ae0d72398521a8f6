"""What an ordinary flight tells of a vehicle without excitation: balances of hovering."""
