"""What happens to a message between two aircraft."""
