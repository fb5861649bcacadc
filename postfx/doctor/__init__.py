"""The doctor: finds what is wrong with a sequence's planes, and says why and how to mend it."""
