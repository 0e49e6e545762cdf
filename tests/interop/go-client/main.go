// Calls that a node refuses, made with grpc-go from the proto files and docs/format.md alone. Prints what a program in Go
// finds in each refusal, one JSON object per line.
//
//	go-client CONTEXT SERVICE
//
// CONTEXT is the directory of a context that may not read SERVICE, such as ~/.config/ledgerd/contexts/Mallory.
package main

import (
	"context"
	"crypto/tls"
	"crypto/x509"
	"encoding/json"
	"fmt"
	"log"
	"os"
	"path/filepath"
	"regexp"
	"time"

	ledgerd "go-client/ledgerd/v1"

	"google.golang.org/genproto/googleapis/rpc/errdetails"
	"google.golang.org/grpc"
	"google.golang.org/grpc/credentials"
	"google.golang.org/grpc/status"
)

func main() {
	directory, service := os.Args[1], os.Args[2]
	node := address(directory)
	named, nameless := connect(node, directory, true), connect(node, directory, false)
	ctx, cancel := context.WithTimeout(context.Background(), time.Minute)
	defer cancel()

	refused("block", func() error {
		_, err := named.GetBlock(ctx, &ledgerd.GetBlockRequest{Height: 1 << 40})
		return err
	})
	refused("no certificate", func() error {
		_, err := nameless.Status(ctx, &ledgerd.StatusRequest{})
		return err
	})
	refused("not admin", func() error {
		_, err := named.Denials(ctx, &ledgerd.DenialsRequest{})
		return err
	})
	refused("behind", func() error {
		_, err := named.Query(ctx, &ledgerd.QueryRequest{Chaincode: "abac", Function: "robots", MinHeight: 1 << 40, MayBeStale: true})
		return err
	})
	refused("id", func() error {
		_, err := named.GetTransaction(ctx, &ledgerd.GetTransactionRequest{Id: []byte("no id")})
		return err
	})
	refused("subscription", func() error {
		request := &ledgerd.SubscribeRequest{Chaincode: "abac", Subjects: []string{service}, Names: []string{"message"}}
		stream, err := named.Subscribe(ctx, request)
		if err == nil {
			_, err = stream.Recv()
		}
		return err
	})
}

// refused prints the status of a call that must fail.
func refused(what string, call func() error) {
	err := call()
	if err == nil {
		log.Fatalf("%s: not refused", what)
	}
	found := status.Convert(err)
	line := map[string]any{"call": what, "grpc": found.Code().String(), "text": found.Message()}
	for _, detail := range found.Details() {
		if info, ok := detail.(*errdetails.ErrorInfo); ok {
			line["reason"], line["domain"], line["metadata"] = info.Reason, info.Domain, info.Metadata
		}
	}
	text, err := json.Marshal(line)
	check(err)
	fmt.Println(string(text))
}

// connect makes a connection as the identity of a context, or as nobody.
func connect(node, directory string, named bool) ledgerd.GatewayClient {
	roots := x509.NewCertPool()
	var organisations []struct{ Roots []string }
	text, err := os.ReadFile(filepath.Join(directory, "msps.json"))
	check(err)
	check(json.Unmarshal(text, &organisations))
	for _, organisation := range organisations {
		for _, root := range organisation.Roots {
			roots.AppendCertsFromPEM([]byte(root))
		}
	}
	config := &tls.Config{
		MinVersion: tls.VersionTLS13,
		// The path to a root counts; names of hosts do not matter between nodes and clients.
		InsecureSkipVerify: true,
		VerifyConnection: func(state tls.ConnectionState) error {
			intermediates := x509.NewCertPool()
			for _, certificate := range state.PeerCertificates[1:] {
				intermediates.AddCert(certificate)
			}
			options := x509.VerifyOptions{Roots: roots, Intermediates: intermediates}
			_, err := state.PeerCertificates[0].Verify(options)
			return err
		},
	}
	if named {
		pair, err := tls.LoadX509KeyPair(filepath.Join(directory, "certificate.pem"), filepath.Join(directory, "key.pem"))
		check(err)
		config.Certificates = []tls.Certificate{pair}
	}
	connection, err := grpc.NewClient(node, grpc.WithTransportCredentials(credentials.NewTLS(config)))
	check(err)
	return ledgerd.NewGatewayClient(connection)
}

// address is the first node of a context.
func address(directory string) string {
	text, err := os.ReadFile(filepath.Join(directory, "context.toml"))
	check(err)
	found := regexp.MustCompile(`nodes\s*=\s*\[\s*"([^"]+)"`).FindSubmatch(text)
	if found == nil {
		log.Fatalf("context.toml names no node: %s", text)
	}
	return string(found[1])
}

func check(err error) {
	if err != nil {
		log.Fatal(err)
	}
}
