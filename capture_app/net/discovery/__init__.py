"""Leaders and relays found by themselves: announced and looked for in the local network (mDNS, RFC 6762).

What is heard there is only a hint of where to ask: anybody can say it, so whoever is found has to answer.
"""
