"""What people look at; imports results only."""
