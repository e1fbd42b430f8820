"""Classical controllers: PID, coupling, observers, feed-forward."""
