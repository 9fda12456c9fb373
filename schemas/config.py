"""What seldom changes of a gateway: the payload of `hexapod/config`."""

from typing import Annotated

from pydantic import AwareDatetime, Field

from schemas.report import Count, Report


class SpiConfig(Report):
    """The SPI device."""

    device: Annotated[str, Field(description="the setting")]
    framing: Annotated[str, Field(description="the setting")]


class WatchdogConfig(Report):
    """The watchdog's settings."""

    timeout_ms: Annotated[float, Field(description="the setting")]
    landing_ms: Annotated[float, Field(description="the setting")] = 0.0


class ButtonsConfig(Report):
    """How many stop buttons must be alive."""

    required: Annotated[Count, Field(description="the setting")] = 0


class CalibrationReport(Report):
    """The calibration in force. Its numbers are on `hexapod/calibration`."""

    revision: Annotated[Count, Field(description="of the calibration in force")] = 0
    fault: Annotated[str | None, Field(description="why the file cannot be used; nothing can start then")] = None
    kept: Annotated[bool, Field(description="whether the next boot finds it")] = False


class TelemetryReport(Report):
    """What the gateway publishes besides the state."""

    frames: Annotated[bool | None, Field(description="whether `hexapod/frame` is published; null: unknown")] = None


class CertificateReport(Report):
    """The first of the gateway's certificates to expire."""

    file: Annotated[str, Field(description="that expires first")]
    expires: Annotated[AwareDatetime, Field(description="when")]


class RevocationsReport(Report):
    """The list of revoked certificates in force."""

    number: Annotated[int, Field(description="of the list in force")]
    date: Annotated[AwareDatetime, Field(description="when it was signed")]


class ServoLimitsReport(Report):
    """The settings' limits of one servo, in degrees as in commands; a speed of 0 is unlimited."""

    min_deg: Annotated[float, Field(description="the setting")] = 0.0
    max_deg: Annotated[float, Field(description="the setting")] = 180.0
    max_speed_deg_s: Annotated[float, Field(description="the setting; 0: unlimited")] = 0.0


class WireReport(Report):
    """The wire to the controller, and what depends on it."""

    name: Annotated[str, Field(description="the setting `wire.name`")] = ""
    whole_robot: Annotated[bool, Field(description="only all servos together can be started and stopped")] = False
    measures: Annotated[bool, Field(description="telemetry comes back")] = False
    acknowledges: Annotated[bool, Field(description="the controller confirms each written frame")] = False
    supply_starts: Annotated[bool, Field(description="with a power board, supply starts a servo")] = False


class LimitsReport(Report):
    """The settings' limits of legs and servos. The calibration's limits are on `hexapod/calibration`."""

    leg_rate_hz: Annotated[float, Field(description="the setting")] = 50.0
    max_age_ms: Annotated[float, Field(description="the setting; 0: any age")] = 500.0
    servos: Annotated[dict[str, ServoLimitsReport], Field(description="of all eighteen, by id")] = {}  # noqa: RUF012  (pydantic copies it)


class ConfigReport(Report):
    """The payload of `hexapod/config`: what seldom changes."""

    config: Annotated[str, Field(description="checksum of these values")] = ""
    version: Annotated[str, Field(description="the gateway's")]
    protocol: Annotated[str, Field(description="`1.0.0`")]
    simulated: Annotated[bool, Field(description="no real device")]
    spi: SpiConfig
    watchdog: WatchdogConfig
    buttons: Annotated[ButtonsConfig, Field(description="an older gateway has none")] = ButtonsConfig()
    calibration: Annotated[CalibrationReport, Field(description="an older gateway has none")] = CalibrationReport()
    telemetry: Annotated[TelemetryReport, Field(description="an older gateway lacks it")] = TelemetryReport()
    certificate: Annotated[CertificateReport | None, Field(description="null: none in use")] = None
    missing_endpoints: Annotated[tuple[str, ...], Field(description="not listened on yet: address is missing")] = ()
    revocations: Annotated[RevocationsReport | None, Field(description="null: no list in force")] = None
    limits: Annotated[LimitsReport, Field(description="an older gateway lacks it")] = LimitsReport()
    wire: Annotated[WireReport, Field(description="an older gateway lacks it")] = WireReport()
    physics: Annotated[str | None, Field(description="Zenoh id of the publisher of `hexapod/sim/body`")] = None
