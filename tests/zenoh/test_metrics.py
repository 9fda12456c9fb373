"""Percentiles, histograms, and what Prometheus reads over HTTP."""

import http.client
import socket
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from gateway import __version__, certs
from gateway.model.frames import PROTOCOL_VERSION
from tests.support.gateway_process import free_port
from tests.support.metrics_page import described, documented
from tests.support.secured import Secured


def read(address: str) -> str:
    with urllib.request.urlopen(f"http://{address}/metrics", timeout=10) as answer:
        return str(answer.read().decode())


def value(page: str, name: str, **labels: str) -> float:
    samples = [sample for family in text_string_to_metric_families(page) for sample in family.samples]
    (found,) = [sample.value for sample in samples if sample.name == name and labels.items() <= sample.labels.items()]
    return float(found)


def test_the_list_in_the_docs_is_the_page_and_no_web_page_reads_it_by_a_name_of_its_own(tmp_path: Path) -> None:
    """DNS rebinding, or a page of another origin. All cases: tests/unit/robot/test_telemetry.py."""
    port = free_port()
    here = f"127.0.0.1:{port}"
    settings = {"telemetry": {"metrics": f"0.0.0.0:{port}"}, "state": {"path": str(tmp_path / "box")}}
    with Secured(tmp_path, settings) as secured, secured.client("anna") as client, client.lease():
        assert client.estop().accepted
        page = read(here)
        assert value(page, "hexapod_sessions") == 1
        assert value(page, "hexapod_incidents_total") == 1
        assert value(page, "hexapod_build_info", version=__version__, protocol=PROTOCOL_VERSION) == 1
        expires = value(page, "hexapod_certificate_expiry_timestamp_seconds", file="gateway.pem")
        assert expires == pytest.approx(time.time() + certs.LEAF_DAYS * 86400, abs=100)
        for path in ("/", "/metric", "/metrics/more", "/favicon.ico"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(f"http://{here}{path}", timeout=10)
        for headers, status in (
            ({"Host": here}, 200),
            ({"Host": f"127.0.0.2:{port}"}, 200),
            ({"Host": f"{socket.gethostname().partition('.')[0]}.local:{port}"}, 200),
            ({"Host": f"evil.example:{port}"}, 403),
            ({"Host": here, "Origin": "http://evil.example"}, 403),
        ):
            reached = "127.0.0.2" if "127.0.0.2" in headers["Host"] else "127.0.0.1"
            asked = http.client.HTTPConnection(reached, port, timeout=10)
            asked.request("GET", "/metrics", headers=headers)
            assert asked.getresponse().status == status, headers
            asked.close()
    assert described(page) == documented()
