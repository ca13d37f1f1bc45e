"""What an autopilot believes of its own motion: sensors that err, and the filter behind them."""
