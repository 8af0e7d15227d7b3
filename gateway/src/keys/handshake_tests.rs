//! Hosts that are let in and hosts that are not, with a gateway and a robot's host on loopback.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use quinn::crypto::rustls::{QuicClientConfig, QuicServerConfig};
use quinn::{Connection, ConnectionError, Endpoint};
use rcgen::{CertificateParams, ExtendedKeyUsagePurpose};
use rustls::pki_types::CertificateDer;
use rustls::{ClientConfig, ServerConfig};
use tempfile::TempDir;

use super::authority::params;
use super::credentials::{as_robot_host, provider};
use super::verifier::AnyCertificate;
use super::*;

const DAY: Duration = Duration::from_secs(86_400);
const WATCHDOG: Duration = Duration::from_secs(20);

/// How often each wrong certificate is tried.
const ATTEMPTS: usize = 100;

fn valid() -> Validity {
    Validity::of_days(1).unwrap()
}

fn gateway() -> Host {
    Host { name: "station".parse().unwrap(), role: HostRole::Gateway }
}

fn alice() -> Host {
    "alice=0,3".parse::<RobotHost>().unwrap().into()
}

fn loaded(keys: &HostKeys) -> Credentials {
    let place = TempDir::new().unwrap();
    let folder = place.path().join("host");
    keys.save(&folder).unwrap();
    Credentials::load(&folder).unwrap()
}

fn credentials(authority: &Authority, host: &Host, validity: Validity) -> Credentials {
    loaded(&make(authority, host, validity).unwrap())
}

fn signed_with(authority: &Authority, host: &Host, change: impl FnOnce(&mut CertificateParams)) -> Credentials {
    let mut params = params(host, valid()).unwrap();
    change(&mut params);
    loaded(&authority.sign(&params).unwrap())
}

/// How a connection went: at the gateway, and at the robot's host.
struct Outcome {
    at_gateway: Result<Option<Peer>, ConnectionError>,
    at_robot_host: Result<(), ConnectionError>,
}

impl Outcome {
    fn causes(&self) -> [Option<RefusalCause>; 2] {
        let cause = |error: Option<&ConnectionError>| error.and_then(RefusalCause::of_connection_error);
        [cause(self.at_gateway.as_ref().err()), cause(self.at_robot_host.as_ref().err())]
    }
}

/// Connects the two; the gateway greets with a datagram, as the first use of the connection.
fn connect(server: ServerConfig, client: ClientConfig) -> Outcome {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let loopback = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let server = QuicServerConfig::try_from(server).unwrap();
        let server = Endpoint::server(quinn::ServerConfig::with_crypto(Arc::new(server)), loopback).unwrap();
        let mut robot_host = Endpoint::client(loopback).unwrap();
        let client = QuicClientConfig::try_from(client).unwrap();
        robot_host.set_default_client_config(quinn::ClientConfig::new(Arc::new(client)));
        let address = server.local_addr().unwrap();

        let at_gateway = async {
            let connection = server.accept().await.unwrap().await?;
            connection.send_datagram("hello".into()).unwrap();
            let peer = peer_of(&connection);
            connection.closed().await;
            Ok(peer)
        };
        let at_robot_host = async {
            let connection = robot_host.connect(address, GATEWAY_NAME).unwrap().await?;
            assert_eq!(&connection.read_datagram().await?[..], b"hello");
            connection.close(0u32.into(), b"");
            Ok(())
        };
        let both = async { tokio::join!(at_gateway, at_robot_host) };
        let (at_gateway, at_robot_host) = tokio::time::timeout(WATCHDOG, both).await.expect("both ends know");
        Outcome { at_gateway, at_robot_host }
    })
}

fn peer_of(connection: &Connection) -> Option<Peer> {
    let chain = connection.peer_identity()?.downcast::<Vec<CertificateDer<'static>>>().unwrap();
    Some(Peer::of(&chain).unwrap())
}

/// Refused however often it is tried: nothing that one attempt leaves behind lets the next one in.
fn assert_refused(server: ServerConfig, client: ClientConfig, cause: RefusalCause) {
    for attempt in 1..=ATTEMPTS {
        let outcome = connect(server.clone(), client.clone());
        let Outcome { at_gateway, at_robot_host } = &outcome;
        assert_eq!(outcome.causes(), [Some(cause); 2], "{attempt}: {at_gateway:?}, robot's host: {at_robot_host:?}");
    }
}

#[test]
fn hosts_of_one_authority_come_together_and_the_gateway_knows_for_whom_the_other_speaks() {
    let authority = Authority::new().unwrap();
    let station = credentials(&authority, &gateway(), valid());
    let alice = credentials(&authority, &alice(), valid());
    let outcome = connect(station.server_config().unwrap(), alice.client_config().unwrap());
    outcome.at_robot_host.unwrap();
    let peer = outcome.at_gateway.unwrap().unwrap();
    assert_eq!((&peer, peer.host.as_str()), (alice.own(), "alice"));
    assert!(peer.may_be(0) && peer.may_be(3) && !peer.may_be(1) && !peer.may_be(usize::MAX) && !peer.is_gateway());
}

#[test]
fn one_folder_of_every_robot_fits_into_a_handshake() {
    let authority = Authority::new().unwrap();
    let station = credentials(&authority, &gateway(), valid());
    let all: Host = "all=0-1023".parse::<RobotHost>().unwrap().into();
    let all = credentials(&authority, &all, valid());
    let outcome = connect(station.server_config().unwrap(), all.client_config().unwrap());
    outcome.at_robot_host.unwrap();
    assert_eq!(outcome.at_gateway.unwrap().unwrap().robots().len(), 1_024);
}

#[test]
fn a_robots_host_without_a_good_certificate_is_refused_and_both_ends_know_why() {
    let (authority, other) = (Authority::new().unwrap(), Authority::new().unwrap());
    let server = || credentials(&authority, &gateway(), valid()).server_config().unwrap();
    let now = SystemTime::now();
    let client = |validity| credentials(&authority, &alice(), validity).client_config().unwrap();

    let nobody = ClientConfig::builder_with_provider(provider())
        .with_protocol_versions(&[&rustls::version::TLS13])
        .unwrap()
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(AnyCertificate(provider())))
        .with_no_client_auth();
    assert_refused(server(), as_robot_host(nobody), RefusalCause::NoCertificate);
    let past = Validity { from: now - 2 * DAY, until: now - DAY };
    assert_refused(server(), client(past), RefusalCause::Expired);
    let future = Validity { from: now + DAY, until: now + 2 * DAY };
    assert_refused(server(), client(future), RefusalCause::Expired);
    // It trusts this authority, and has its own certificate from the other.
    let stranger =
        credentials(&other, &alice(), valid()).with_authority_of(&credentials(&authority, &alice(), valid()));
    assert_refused(server(), stranger.client_config().unwrap(), RefusalCause::UnknownAuthority);
    // A gateway may not speak for a robot.
    let gateway = credentials(&authority, &gateway(), valid());
    assert_refused(server(), gateway.client_config().unwrap(), RefusalCause::BadCertificate);
}

#[test]
fn a_gateway_without_a_good_certificate_is_refused_and_both_ends_know_why() {
    let (authority, other) = (Authority::new().unwrap(), Authority::new().unwrap());
    let client = || credentials(&authority, &alice(), valid()).client_config().unwrap();
    let server = |validity| credentials(&authority, &gateway(), validity).server_config().unwrap();
    let now = SystemTime::now();

    assert_refused(server(Validity { from: now - 2 * DAY, until: now - DAY }), client(), RefusalCause::Expired);
    let stranger = credentials(&other, &gateway(), valid());
    assert_refused(stranger.server_config().unwrap(), client(), RefusalCause::UnknownAuthority);
    // Without keys it has a certificate that it signed itself.
    assert_refused(Credentials::for_loopback_server().unwrap(), client(), RefusalCause::UnknownAuthority);
    let robots = credentials(&authority, &alice(), valid());
    assert_refused(robots.server_config().unwrap(), client(), RefusalCause::NotGateway);
    let with_purpose = signed_with(&authority, &alice(), |params| {
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    });
    assert_refused(with_purpose.server_config().unwrap(), client(), RefusalCause::NotGateway);
}

#[test]
fn another_version_is_refused_and_both_ends_know_why() {
    let authority = Authority::new().unwrap();
    let server = credentials(&authority, &gateway(), valid()).server_config().unwrap();
    let mut client = credentials(&authority, &alice(), valid()).client_config().unwrap();
    client.alpn_protocols = vec![b"rangehound/2".to_vec()];
    assert_refused(server, client, RefusalCause::Version);
}

#[test]
fn on_loopback_no_keys_are_needed() {
    let outcome = connect(Credentials::for_loopback_server().unwrap(), Credentials::for_loopback_client().unwrap());
    outcome.at_robot_host.unwrap();
    assert_eq!(outcome.at_gateway.unwrap(), None);
}

#[test]
fn a_gateway_with_keys_refuses_a_robots_host_without() {
    let station = credentials(&Authority::new().unwrap(), &gateway(), valid());
    let client = Credentials::for_loopback_client().unwrap();
    assert_refused(station.server_config().unwrap(), client, RefusalCause::NoCertificate);
}

#[test]
fn a_folder_that_is_not_complete_is_refused_in_one_line() {
    let authority = Authority::new().unwrap();
    let place = TempDir::new().unwrap();
    let folder = |name: &str| place.path().join(name);
    make(&authority, &alice(), valid()).unwrap().save(&folder("alice")).unwrap();
    make(&authority, &gateway(), valid()).unwrap().save(&folder("station")).unwrap();
    let file = |name: &str| folder("alice").join(name);
    for name in ["authority.pem", "host.pem", "host.key"] {
        let whole = std::fs::read(file(name)).unwrap();
        let half = whole[..whole.len() / 2].to_vec();
        let junk = b"-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n".to_vec();
        for damaged in [None, Some(vec![]), Some(half), Some(junk), Some(vec![0xff; 1_000])] {
            match damaged {
                Some(bytes) => std::fs::write(file(name), bytes).unwrap(),
                None => std::fs::remove_file(file(name)).unwrap(),
            }
            let refusal = Credentials::load(&folder("alice")).unwrap_err().to_string();
            assert!(refusal.contains(name) && !refusal.contains('\n'), "{refusal}");
        }
        std::fs::write(file(name), whole).unwrap();
    }
    Credentials::load(&folder("alice")).unwrap();
    std::fs::copy(folder("station").join("host.key"), file("host.key")).unwrap();
    let refusal = Credentials::load(&folder("alice")).unwrap_err();
    assert!(matches!(refusal, KeysError::NotAPair(_)), "{refusal}");
}
