"""What an ordinary flight without excitation shows of a vehicle: balances in hover."""
