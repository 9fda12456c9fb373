"""Mutants of the lease: who may move the robot, and who is believed to be whom."""

from tests.mutants.mutant import Mutant, Subject

LEASE = Subject(
    "gateway/robot/core/lease.py",
    tests=(
        "tests/unit/robot/test_lease.py",
        "tests/unit/robot/test_lease_conductor.py",
        "tests/unit/robot/test_supervisor_machine.py",
    ),
    mutants=(
        Mutant(
            "            if token is not None and hmac.compare_digest(token, self._token):\n",
            "            if token is not None:\n",
            "any token moves the robot, also that of somebody whose lease was taken",
        ),
        Mutant(
            "            if token is not None and hmac.compare_digest(token, self._token):\n",
            "            if token is None or hmac.compare_digest(token, self._token):\n",
            "whoever knows nothing of leases moves the robot under its driver",
        ),
        Mutant(
            "        if token is not None:\n            return Reason.NOT_HOLDER",
            "        if False:\n            return Reason.NOT_HOLDER",
            "a former holder's queue moves the robot once the lease is free",
        ),
        Mutant(
            "        if self._rules.lease_required and not reset:\n",
            "        if self._rules.lease_required:\n",
            "where the lease is required, nobody can leave an emergency stop",
        ),
        Mutant(
            "        if self._rules.lease_required and not reset:\n",
            "        if False:\n",
            "lease.required is a setting that does nothing",
        ),
        Mutant(
            "        if self.holder is not None:\n            return Reason.NOT_HOLDER",
            "        if False:\n            return Reason.NOT_HOLDER",
            "while the lease is handed over, anybody moves the robot",
        ),
        Mutant(
            "        if self._holds(token):\n            self.due_ns",
            "        if True:\n            self.due_ns",
            "a stranger's Stop keeps the lease of a holder who has fallen silent",
        ),
        Mutant(
            "        if self._holds(token):\n            self.due_ns = now_ns + self._rules.lease_ttl_ns\n",
            "        pass\n",
            "a stream without renewals loses its lease",
        ),
        Mutant("now_ns < self.due_ns:", "now_ns <= self.due_ns:", "the lease expires late, and the loop spins"),
        Mutant(
            "        effects: list[Effect] = [Announce(Kind.LEASE_EXPIRED, detail, self.holder)]\n        self.end()\n",
            "        effects: list[Effect] = [Announce(Kind.LEASE_EXPIRED, detail, self.holder)]\n",
            "a silent holder keeps the robot for ever",
        ),
        Mutant(
            "return request.do is Do.TAKE and (self._rules.lease_takeover or self.holder is None)",
            "return request.do is Do.TAKE and self.holder is not None",
            "the legs run on under whoever takes a free lease, and lease.takeover does nothing",
        ),
        Mutant(
            "return request.do is Do.TAKE and (self._rules.lease_takeover or self.holder is None)",
            "return request.do is Do.TAKE",
            "a lease that is never to be taken is taken",
        ),
        Mutant(
            "if self.holder is not None and not (handed_over and request.source == self.holder):",
            "if self.holder is not None and not handed_over:",
            "whoever is first gets what was handed over to another",
        ),
        Mutant(
            "if self.holder is not None and not (handed_over and request.source == self.holder):",
            "if self.holder is not None and request.source != self.holder:",
            "a second program of the holder's ends the lease of the first",
        ),
        Mutant("        if to not in self._askers:\n", "        if False:\n", "a typing error gives the robot away"),
        Mutant(
            "        self._give(to, None, now_ns, verified=self._askers[to])\n",
            "        self._give(to, self._token, now_ns, verified=self._askers[to])\n",
            "who has handed the robot over goes on driving it",
        ),
        Mutant("verified=self._askers[to])", "verified=True)", "a name counts as proved that nobody has proved"),
        Mutant(
            "        if not self._holds(request.token):\n            return self._rejected(Reason.NOT_HOLDER, _ENDED)\n"
            "        self.due_ns",
            "        self.due_ns",
            "anybody keeps anybody's lease",
        ),
        Mutant(
            "        if not self._holds(request.token):\n            return self._rejected(Reason.NOT_HOLDER, _ENDED)\n"
            "        if to is None:",
            "        if to is None:",
            "a stranger releases the holder's lease",
        ),
        Mutant(
            "        if len(self._askers) == MOST_ASKERS:\n            del self._askers[next(iter(self._askers))]\n",
            "",
            "whoever asks under many names uses up the robot's memory",
        ),
        Mutant("        self._askers.pop(name, None)\n", "", "of two who ask, the latest is not the one that is shown"),
        Mutant("        self._askers = {}\n", "", "who asked the last holder can be given the next one's lease"),
        Mutant(
            "        self.guards = holder is not None or self._rules.lease_required\n",
            "        self.guards = token is not None or self._rules.lease_required\n",
            "while the lease is handed over, whoever knows nothing of leases moves the robot",
        ),
        Mutant(
            "        gives = request.do in (Do.ACQUIRE, Do.TAKE)\n",
            "        gives = True\n",
            "whoever asks for the lease hears the holder's token",
        ),
        Mutant(
            "        self.since_ns = None if token is None else now_ns\n",
            "        self.since_ns = now_ns\n",
            "a lease that is handed over is shown as held",
        ),
        Mutant("        self.changes[kind] += 1\n", "", "the metrics count no change of hands"),
    ),
)
PROOF = Subject(
    "gateway/certs/proof.py",
    tests=("tests/unit/people/test_lease_checker.py",),
    mutants=(
        Mutant(
            "            if fault is None and not _signed(",
            "            if fault is not None and not _signed(",
            "a certificate alone, which is no secret, proves a name",
        ),
        Mutant(
            "        if not any(_issued(certificate, ca, now) for ca in self._cas):\n",
            "        if not self._cas:\n",
            "anybody makes a certificate and is believed",
        ),
        Mutant("        if now < start:\n", "        if False:\n", "a certificate of tomorrow counts today"),
        Mutant("        if now > end:\n", "        if False:\n", "a certificate counts for ever"),
        Mutant(
            "    if not ca.not_valid_before_utc <= now <= ca.not_valid_after_utc:\n        return False\n",
            "",
            "a CA that is over still vouches",
        ),
        Mutant(
            "        certificate.verify_directly_issued_by(ca)\n",
            "        assert certificate.issuer == ca.subject\n",
            "whoever writes the CA's name into a certificate is believed",
        ),
        Mutant(
            "        if wrong_clock is not None:\n            return wrong_clock\n",
            "",
            "a robot whose clock is wrong rejects everybody and does not say why",
        ),
        Mutant(
            "x509.load_pem_x509_certificates(proof.certificate.encode())[0]",
            "x509.load_pem_x509_certificates(proof.certificate.encode())[-1]",
            "of a chain, another certificate than the owner's is looked at",
            equivalent="the issuer's certificate has no operator's role, so a chain is then rejected: nobody is let in",
        ),
        Mutant('robot if kind == "robot" else ""', '""', "in a fleet nobody drives"),
    ),
)
DESK = Subject(
    "gateway/robot/edge/lease_request_reader.py",
    tests=(
        "tests/unit/people/test_lease_checker.py",
        "tests/unit/robot/test_lease_conductor.py",
        "tests/zenoh/test_lease.py",
    ),
    mutants=(),
)
NONCES = Subject(
    "gateway/robot/core/nonces.py",
    tests=("tests/unit/people/test_lease_checker.py",),
    mutants=(
        Mutant("self._until_ns.pop(nonce, None)", "self._until_ns.get(nonce)", "a proof is used twice"),
        Mutant("and now_ns < until_ns", "", "a proof that was overheard is used hours later"),
        Mutant(
            "        if len(self._until_ns) >= MOST_NONCES:\n            del self._until_ns[next(iter(self._until_ns))]\n",
            "",
            "whoever asks for nonces uses up the robot's memory",
        ),
    ),
)
