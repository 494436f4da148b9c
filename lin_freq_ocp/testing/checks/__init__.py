"""One random problem after another, solved here and by an independent way, and compared: ``check(seed)``.

Every outcome says what is wrong, if anything; scripts/verify.py goes through many seeds.
"""
