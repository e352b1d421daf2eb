"""Place recognition: finding a place again without a guess of where it is."""
