"""Parameter sets of infinitely many constraints beyond the frequencies of a DFT."""
