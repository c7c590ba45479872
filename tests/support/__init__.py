"""What tests of several rooms share: small spaces, circuits and decks, worlds with hidden obstacles, simulators."""
