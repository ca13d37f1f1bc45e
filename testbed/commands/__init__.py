"""Programs that command aircraft: sessions, navigation, the gate of ticks."""
