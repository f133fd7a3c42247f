"""Whether what an answer says of itself comes true, on machines that share no code with hydroopt and on real ones."""
